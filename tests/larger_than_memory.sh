#!/bin/sh
# Renders a volume three times larger than the memory it may use, from a cache file, and holds the
# picture against one rendered without a limit: the same numbers to the last digit.
#
#   cargo build --release --examples --bin majorant
#   tests/larger_than_memory.sh [RESOLUTION] [FOLDER]
#
# Needs a control group with a memory limit, which counts the pages of mapped files and takes them
# back when the limit is met. `ulimit -v` will not do: it counts addresses, and a map of a file has
# as many as the file has bytes. Where no group can be made, a line says so and nothing is tested.
set -eu

here=$(cd "$(dirname "$0")/.." && pwd)
target=${CARGO_TARGET_DIR:-$here/target}/release
resolution=${1:-512}
work=$(mktemp -d "${2:-${TMPDIR:-/tmp}}/majorant-large-XXXXXX")
group=
trap 'rm -rf "$work"; [ -z "$group" ] || rmdir "$group" 2>/dev/null || true' EXIT

# Prints the folder of a new control group of at most $1 bytes, version 2 or 1.
limited_group() {
    for parent in /sys/fs/cgroup /sys/fs/cgroup/memory; do
        new=$parent/majorant-$$
        mkdir "$new" 2>/dev/null || continue
        for file in memory.max memory.limit_in_bytes; do
            if [ -e "$new/$file" ] && echo "$1" >"$new/$file" 2>/dev/null; then
                # No help from swap space.
                [ ! -e "$new/memory.swap.max" ] || echo 0 >"$new/memory.swap.max"
                echo "$new"
                return
            fi
        done
        rmdir "$new" 2>/dev/null || true
    done
}

"$target/examples/make_field" "$resolution" f32 "$work/field.mjc"
bytes=$(stat -c %s "$work/field.mjc")
limit=$((bytes / 3))
group=$(limited_group "$limit")
if [ -z "$group" ]; then
    echo "skipped: no control group with a memory limit can be made here"
    exit 0
fi

cat >"$work/scene.toml" <<END
[image]
resolution = [96, 96]
[camera]
position = [0.0, -3.0, 0.2]
look_at = [0.0, 0.0, 0.0]
vertical_fov_degrees = 20.0
[[volume]]
file = "field.mjc"
density = { grid = "density", scale = 60.0 }
[[light]]
type = "constant"
radiance = [0.5, 0.7, 1.0]
[[light]]
type = "distant"
direction_to_light = [0.5, -0.5, 0.7]
irradiance = [4.0, 4.0, 4.0]
[render]
spp = 2
END

run() {
    "$target/majorant" render "$work/scene.toml" -q -o "$work/$1.exr" \
        --stats-json "$work/$1.json" --max-memory "$limit"
}
mean() {
    tr -d ' \n' <"$work/$1.json" | sed 's/.*"image_mean":\(\[[^]]*\]\).*/\1/'
}
number() {
    tr -d ' \n' <"$work/$1.json" | sed "s/.*\"$2\":\([0-9.e+-]*\).*/\1/"
}

run free
# Nothing of the file is left in memory: the group pays for each page it reads.
sync "$work/field.mjc"
dd if="$work/field.mjc" iflag=nocache count=0 status=none
(
    echo 0 >"$group/cgroup.procs"
    run limited
)
peak=$(cat "$group/memory.peak" "$group/memory.max_usage_in_bytes" 2>/dev/null | head -1)
echo "file $bytes bytes, limit $limit, peak of the group $peak"
echo "without a limit  mean $(mean free), resident at most $(number free peak_memory_bytes)"
echo "with the limit   mean $(mean limited), resident at most $(number limited peak_memory_bytes)"
[ "$(mean free)" = "$(mean limited)" ] || {
    echo "FAILED: the means differ"
    exit 1
}
[ "$(number limited bound_violations)" = 0 ] || {
    echo "FAILED: bounds are violated"
    exit 1
}
echo "passed"
