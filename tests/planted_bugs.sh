#!/usr/bin/env bash
# Plants known bugs one at a time into a copy of the source and shows which tests catch them.
# A bug that no test catches makes the script fail. Takes about a minute a bug on two cores.
#
#   tests/planted_bugs.sh            all of them
#   tests/planted_bugs.sh bound hg   those whose name contains one of the words
set -uo pipefail
cd "$(dirname "$0")/.." || exit 1

# The tests must pass without a bug before any counts as caught.
# name @@ file @@ text to find @@ text to put in its place
bugs=(
    'bound x 0.9 @@ src/medium.rs @@ s.bound.max * scale @@ s.bound.max * scale * 0.9'
    'bounds without the neighbours layer @@ src/grid/bounds.rs @@ side, &mut |v| bound.include(v)); @@ side, &mut |_| ());'
    'no halo below bricks @@ src/grid/bounds.rs @@ differs |= v != tree.tiles[t].value; @@ differs |= v.is_nan() && t > 0;'
    'hg sign in eval @@ src/phase.rs @@ eval_henyey_greenstein(g, 1.0 - cos_theta) @@ eval_henyey_greenstein(g, 1.0 + cos_theta)'
    'hg sign in sample @@ src/phase.rs @@ + direction * (1.0 - x) @@ - direction * (1.0 - x)'
    'albedo counted twice @@ src/integrator/path.rs @@ throughput *= medium.albedo(); @@ throughput *= medium.albedo() * medium.albedo();'
    'absorption forgotten @@ src/integrator/path.rs @@ throughput *= medium.albedo(); @@ '
    'one tap rounds down @@ src/grid/sampler.rs @@ p_index + DVec3::new(u(0), u(21), u(42)) @@ p_index + 0.0 * DVec3::new(u(0), u(21), u(42))'
    'depth not used up at borders @@ src/tracking/collision.rs @@ depth -= left; @@ '
    'roulette without weight @@ src/tracking/transmittance.rs @@ self.weight = self.roulette_weight; @@ '
    'path roulette without weight @@ src/integrator/path.rs @@ throughput *= ROULETTE_WEIGHT / weight; @@ '
    'sun disk of twice the radiance @@ src/light.rs @@ 1.0 / (PI * x * (2.0 - x)) @@ 2.0 / (PI * x * (2.0 - x))'
    'samples share a stream @@ src/sampling.rs @@ mix(h ^ sample.wrapping_add(GOLDEN)) @@ mix(h ^ (sample & 0).wrapping_add(GOLDEN))'
)

copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
export CARGO_TARGET_DIR=$PWD/target/planted
run_tests() {
    rm -rf "${copy:?}"/*
    cp -r Cargo.toml Cargo.lock README.md src tests benches data docs "$copy"
    [ $# = 0 ] || plant "$1" || { echo "the text to replace is not there once"; exit 1; }
    (cd "$copy" && cargo test --no-fail-fast --lib --test free_flight --test transport --test grid_properties 2>&1)
}
plant() {
    python3 - "$copy" "$1" <<'PY'
import sys
folder, bug = sys.argv[1:]
_, path, find, put = bug.split(" @@ ")
text = open(f"{folder}/{path}").read()
open(f"{folder}/{path}", "w").write(text.replace(find, put))
sys.exit(text.count(find) != 1)
PY
}
failures() { sed -n 's/^test \(.*\) \.\.\. FAILED$/\1/p' <<<"$1" | sort -u | paste -sd' '; }

log=$(run_tests)
if ! grep -q '^test result: ok' <<<"$log" || [ -n "$(failures "$log")" ]; then
    echo "without any bug: $(failures "$log")"
    tail -20 <<<"$log"
    exit 1
fi
missed=0
for bug in "${bugs[@]}"; do
    name=${bug%% @@ *}
    if [ $# -gt 0 ]; then
        wanted=0
        for word in "$@"; do [[ $name == *"$word"* ]] && wanted=1; done
        [ $wanted = 1 ] || continue
    fi
    log=$(run_tests "$bug")
    if grep -q '^error: could not compile' <<<"$log"; then
        echo "$name: does not compile"
        exit 1
    fi
    caught=$(failures "$log")
    printf '%s\n    %s\n' "$name" "${caught:-MISSED}"
    [ -n "$caught" ] || missed=1
done
exit $missed
