#!/usr/bin/env bash
# Plants known bugs one at a time into a copy of the source and shows what catches them: tests, or
# rows of `majorant verify`. A bug that nothing catches makes the script fail. Takes about a minute
# a bug on two cores.
#
#   tests/planted_bugs.sh            the tests that fail for each bug
#   tests/planted_bugs.sh --verify   the rows of `majorant verify` and `--stiff` that fail
#   tests/planted_bugs.sh bound hg   either, for bugs whose name contains one of the words
set -uo pipefail
cd "$(dirname "$0")/.." || exit 1

# The tests must pass without a bug before any counts as caught.
# name @@ file @@ text to find @@ text to put in its place @@ checks of `verify` to run, `-` for none
bugs=(
    'bound x 0.9 @@ src/medium.rs @@ bound.max * scale, @@ bound.max * scale * 0.9, @@ free flight'
    'bounds without the neighbours layer @@ src/grid/bounds.rs @@ side, &mut |v| bound.include(v)); @@ side, &mut |_| ()); @@ free flight'
    'no halo below bricks @@ src/grid/bounds.rs @@ differs |= v != tree.tiles[t].value; @@ differs |= v.is_nan() && t > 0; @@ -'
    'hg sign in eval @@ src/phase/mod.rs @@ eval_henyey_greenstein(g, 1.0 - cos_theta) @@ eval_henyey_greenstein(g, 1.0 + cos_theta) @@ ball, single scattering'
    'hg sign in sample @@ src/phase/mod.rs @@ + direction * (1.0 - x) @@ - direction * (1.0 - x) @@ g 0.75 tau 2 normal analog'
    'albedo counted twice @@ src/integrator/path.rs @@ throughput *= walk.albedo(t); @@ throughput *= walk.albedo(t) * walk.albedo(t); @@ albedos path'
    'absorption forgotten @@ src/integrator/path.rs @@ throughput *= walk.albedo(t); @@ @@ albedos path'
    'one tap rounds down @@ src/grid/sampler.rs @@ p_index + DVec3::new(u(0), u(21), u(42)) @@ p_index + 0.0 * DVec3::new(u(0), u(21), u(42)) @@ free flight: lone'
    'depth not used up at borders @@ src/tracking/collision.rs @@ depth -= left; @@ @@ free flight: step'
    'roulette without weight @@ src/tracking/transmittance.rs @@ self.weight = self.roulette_weight; @@ @@ transmittance: oblique step'
    'path roulette without weight @@ src/integrator/path.rs @@ throughput *= roulette_weight / worth; @@ @@ dark slab'
    'sun disk of twice the radiance @@ src/light/distant.rs @@ 1.0 / (PI * x * (2.0 - x)) @@ 2.0 / (PI * x * (2.0 - x)) @@ first order flux'
    'expected collision: always the last @@ src/tracking/expected.rs @@ if left < w { @@ if w > 0.0 { @@ -'
    'expected collision: weight not used up @@ src/tracking/expected.rs @@ self.weight -= w; @@ @@ -'
    'depths of camera rays share a number @@ src/tracking/expected.rs @@ self.depth_count += 1; @@ @@ -'
    'a tail of 24 digits @@ src/sampling.rs @@ self.number(of) + self.uniform_positive() @@ self.number(of) + 1.0 @@ -'
    'accepted by the largest value of its cell @@ src/grid/sampler.rs @@ if accepts(min) { @@ if accepts(max) { @@ -'
    'bounds of blocks rounded down @@ src/grid/blocks.rs @@ bound.max.to_bits().div_ceil(1 << 16) @@ (bound.max.to_bits() >> 16) @@ -'
    'hints rounded down @@ src/grid/cells.rs @@ (near(bound.max)..=u8::MAX).find(|&c| decode(c, unit) >= bound.max) @@ Some(near(bound.max)) @@ -'
    'roulette about black @@ src/integrator/primary.rs @@ sky(opacity - weight) @@ sky(opacity) @@ -'
    'voxels felt in their own cell only @@ src/grid/occupied.rs @@ visit(around(min, -1.0), around(max, 1.0)) @@ visit(around(min, 0.0), around(max, 1.0)) @@ -'
    'draine without its square @@ src/phase/draine.rs @@ self.alpha * cos * cos @@ self.alpha * cos @@ -'
    'lobes swapped @@ src/phase/mod.rs @@ if choice < first_weight { a } else { b } @@ if choice < first_weight { b } else { a } @@ -'
    'rayleigh without its cube @@ src/phase/mod.rs @@ / 3.0).sinh() @@ / 2.9).sinh() @@ -'
    'density of the cell beside @@ src/light/environment.rs @@ self.cell_excess(place.row, place.column) @@ self.cell_excess(place.row, place.column / 2) @@ -'
    'sky met and sampled in full @@ src/integrator/surroundings.rs @@ radiance * (phase / (phase + pdf)) @@ radiance @@ -'
    'equiangular light in full @@ src/integrator/surroundings.rs @@ probability * densities.sum(phase * light.solid_angle) @@ probability * densities.equiangular @@ -'
    'sphere of half its solid angle @@ src/light/local.rs @@ (2.0 * PI * one_minus_cos) as f32 @@ (PI * one_minus_cos) as f32 @@ -'
    'null collisions of one colour @@ src/tracking/chromatic/flight.rs @@ (1.0 - tint * part) * scale @@ (1.0 - part) * scale @@ -'
    'other media let all light through @@ src/integrator/media.rs @@ except != Some(index) && weight > 0.0 @@ except.is_none() && weight > 0.0 @@ -'
    'the last medium collides first @@ src/integrator/media.rs @@ t_max = t; @@ @@ -'
    'light of media found twice @@ src/integrator/emission.rs @@ 1.0 - emitter.light_weight(p, (t, phase)) @@ 1.0 @@ -'
    'light of media by another density @@ src/emission/lattice.rs @@ self.fine.weights[index] * self.density_per_weight; @@ self.fine.weights[index] * self.density_per_weight * 1.1; @@ -'
    'colours of a flight forgotten @@ src/integrator/emission.rs @@ medium.emitted(p) * through * (length * weight) @@ medium.emitted(p) * (length * weight) @@ -'
    'settled segments of one colour @@ src/tracking/chromatic/flight.rs @@ None => attenuate(tint, depth), @@ None => Rgb::WHITE, @@ -'
    'a lamp in the group of another @@ src/integrator/parts.rs @@ Source::Lamp(i) => *skies + i, @@ Source::Lamp(_) => *skies, @@ -'
    'paths not sent to light weigh too little @@ src/integrator/steering.rs @@ let mix = (1.0 - sent) * phase + towards; @@ let mix = phase + towards; @@ -'
    'directions of light by another density @@ src/emission/lattice.rs @@ (t1 * t1 * t1 - t0 * t0 * t0) / 3.0 @@ (t1 * t1 * t1 - t0 * t0 * t0) / 3.1 @@ -'
    'points along rays start at the first @@ src/emission/lattice.rs @@ f64::from(spacing) * f64::from(u); @@ f64::from(spacing) * f64::from(u) * 0.9; @@ -'
    'black bodies of another colour @@ src/blackbody.rs @@ const STEP: f64 = 5e-9; @@ const STEP: f64 = 5.1e-9; @@ -'
    'samples share a stream @@ src/sampling.rs @@ mix(pixel_hash ^ sample.wrapping_add(GOLDEN)) @@ mix(pixel_hash ^ (sample & 0).wrapping_add(GOLDEN)) @@ homogeneous tile'
)
# For `--verify` alone: what tests see less directly.
more_bugs=(
    'residual without its control @@ src/tracking/transmittance.rs @@ (-optical_depth(control, length)).exp() @@ 1.0 @@ transmittance: ramp'
    'decomposition by the mean @@ src/tracking/distance.rs @@ threshold <= segment.sigma_min @@ threshold <= segment.sigma_mean @@ free flight: ramp'
    'integral without its last term @@ src/grid/cubic.rs @@ s * (c2 / 3.0 + s * (c3 / 4.0)) @@ s * (c2 / 3.0) @@ rays on faces'
    'directions renormalised in index space @@ src/medium.rs @@ to_index.transform_vector3(ray.direction) @@ to_index.transform_vector3(ray.direction).normalize_or_zero() @@ affine maps: transmittance'
    'values half a voxel off @@ src/medium.rs @@ to_index.transform_point3(ray.origin) @@ to_index.transform_point3(ray.origin) + 0.5 @@ one voxel: tent'
    'positions in f32 @@ src/medium.rs @@ to_index.transform_point3(ray.origin) @@ to_index.transform_point3(ray.origin.as_vec3().as_dvec3()) @@ cameras far away'
    'a cut-off at 1e-9 @@ src/tracking/collision.rs @@ (f64::from(sigma) * length) as f32 @@ (if sigma < 1e-9 { 0.0 } else { f64::from(sigma) * length }) as f32 @@ hidden cut-offs'
    'a cap of 64 bounces @@ src/integrator/path.rs @@ settings.max_bounces == Some(bounces) @@ settings.max_bounces == Some(bounces) || bounces == 64 @@ thousands of bounces: cloud'
    'uniform numbers of 24 bits @@ src/sampling.rs @@ -self.uniform_positive().ln() @@ -(1.0 - self.uniform()).ln() @@ ends of the uniform'
    'textbook form of Henyey and Greenstein @@ src/phase/mod.rs @@ e * (1.0 - u) * (s + e) / d @@ 1.0 - (1.0 + a * a - s * s) / (2.0 * a) @@ g near'
    'pixels share their noise @@ src/sampling.rs @@ pixel.wrapping_mul(GOLDEN) @@ (pixel / 2).wrapping_mul(GOLDEN) @@ independent pixels'
)

mode=tests
if [ "${1:-}" = --verify ]; then
    mode=rows
    bugs+=("${more_bugs[@]}")
    shift
fi
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
export CARGO_TARGET_DIR=$PWD/target/planted
put_copy() { # bug, or nothing
    rm -rf "${copy:?}"/*
    cp -r Cargo.toml Cargo.lock README.md src tests benches data docs "$copy"
    [ $# = 0 ] || plant "$1" || { echo "the text to replace is not there once"; exit 1; }
}
run_tests() {
    put_copy "$@"
    (cd "$copy" && cargo test --no-fail-fast --lib --test estimators --test light 2>&1)
}
# Debug assertions are off, as for users. A check that does not end in ten minutes counts as failed.
run_rows() { # checks, bug or nothing
    local checks=$1
    shift
    put_copy "$@"
    (
        cd "$copy" || exit
        export CARGO_PROFILE_RELEASE_INCREMENTAL=true CARGO_PROFILE_RELEASE_DEBUG=false
        cargo build --release 2>&1 || exit
        for stiff in "" --stiff; do
            # shellcheck disable=SC2086
            timeout 600 "$CARGO_TARGET_DIR/release/majorant" -q verify $stiff --filter "$checks" 2>&1
            [ $? != 124 ] || echo "  checks that do not end FAIL"
        done
    )
}
plant() {
    python3 - "$copy" "$1" <<'PY'
import sys
folder, bug = sys.argv[1:]
_, path, find, put, _ = [part.strip() for part in bug.split("@@")]
text = open(f"{folder}/{path}").read()
open(f"{folder}/{path}", "w").write(text.replace(find, put))
sys.exit(text.count(find) != 1)
PY
}
failures() { # log
    if [ $mode = tests ]; then
        sed -n 's/^test \(.*\) \.\.\. FAILED$/\1/p' <<<"$1" | sort -u | paste -sd' '
    else
        awk '/ FAIL$/ { n++; if (n <= 4) { sub(/^ */, ""); sub(/   *.*/, ""); printf "%s%s", s, $0; s = "; " } }
             END { if (n > 4) printf "; and %d more", n - 4; if (n) print "" }' <<<"$1"
    fi
}

if [ $mode = tests ]; then
    log=$(run_tests)
    good='^test result: ok'
else
    log=$(run_rows "the same bits")
    good=' 0 failed$'
fi
if ! grep -q "$good" <<<"$log" || [ -n "$(failures "$log")" ]; then
    echo "without any bug: $(failures "$log")"
    tail -20 <<<"$log"
    exit 1
fi
missed=0
for bug in "${bugs[@]}"; do
    name=${bug%% @@ *}
    checks=${bug##*@@ }
    if [ $# -gt 0 ]; then
        wanted=0
        for word in "$@"; do [[ $name == *"$word"* ]] && wanted=1; done
        [ $wanted = 1 ] || continue
    fi
    if [ $mode = tests ]; then
        log=$(run_tests "$bug")
    elif [ "$checks" = - ]; then
        continue
    else
        log=$(run_rows "$checks" "$bug")
    fi
    if grep -q '^error: could not compile' <<<"$log"; then
        echo "$name: does not compile"
        exit 1
    fi
    caught=$(failures "$log")
    printf '%s\n    %s\n' "$name" "${caught:-MISSED}"
    [ -n "$caught" ] || missed=1
done
exit $missed
