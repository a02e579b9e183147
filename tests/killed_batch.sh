#!/usr/bin/env bash
# A batch of real frames, killed by SIGKILL at random moments and started again by the same command
# line, ends with the bits of an undisturbed batch; what stands under an image's name is always whole.
#
#   tests/killed_batch.sh [KILLS]      default 20; needs a release build, or MAJORANT=…
#
# Frames 22 to 26 of ../shared/volumes/mantaflow/campfire, or where that is absent the two of data/fire.
set -euo pipefail
cd "$(dirname "$0")/.."
kills=${1:-20}
program=${MAJORANT:-target/release/majorant}
volumes=$PWD/../shared/volumes/mantaflow/campfire/fluid_data_####.vdb
frames=22-26
if [ ! -e "${volumes/####/0024}" ]; then
    volumes=$PWD/data/fire/campfire_####.vdb
    frames=24,26
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sed -e "s|^file = .*|file = \"$volumes\"|" data/scenes/fire_smoke.toml >"$work/fire.toml"
command=("$program" render "$work/fire.toml" -f "$frames" -r 135x240 --spp "${SPP:-128}" -q
    --skip-existing --resume --checkpoint 0.5s)

start=$(date +%s%N)
"${command[@]}" -o "$work/whole/f.####.exr"
took_ms=$((($(date +%s%N) - start) / 1000000))
echo "undisturbed: $took_ms ms"

# The pixels without what differs from run to run: when, how long, by which command.
same() { "$program" compare "$1" "$2" --json | grep -q '"max_difference": 0.0'; }

done_kills=0
rounds=0
declare -A finished=()
while [ "$done_kills" -lt "$kills" ]; do
    rounds=$((rounds + 1))
    "${command[@]}" -o "$work/killed/f.####.exr" &
    child=$!
    # Anywhere in a quarter of the time that all takes: a batch makes some headway between two kills.
    sleep "$(awk -v t="$took_ms" -v r="$RANDOM" 'BEGIN { print t / 4000 * r / 32768 }')"
    if kill -KILL "$child" 2>/dev/null; then done_kills=$((done_kills + 1)); fi
    wait "$child" 2>/dev/null || true
    for image in "$work"/killed/f.*.exr; do
        [ -e "$image" ] || continue
        name=$(basename "$image")
        same "$image" "$work/whole/$name" || { echo "FAILED: $name differs after $done_kills kills"; exit 1; }
        date=$(stat -c %y "$image")
        [ "${finished[$name]:-$date}" = "$date" ] || { echo "FAILED: $name was rendered again"; exit 1; }
        finished[$name]=$date
    done
    # All done early: begin again, so that all the kills hit a batch at work.
    if [ "${#finished[@]}" = "$(find "$work/whole" -name 'f.*.exr' | wc -l)" ]; then
        rm -rf "$work/killed"
        finished=()
    fi
done
"${command[@]}" -o "$work/killed/f.####.exr"
for image in "$work"/whole/f.*.exr; do
    same "$image" "$work/killed/$(basename "$image")" || { echo "FAILED: $(basename "$image")"; exit 1; }
done
left=$(find "$work/killed" -name '*.checkpoint' | wc -l)
[ "$left" = 0 ] || { echo "FAILED: $left checkpoints are left"; exit 1; }
echo "ok: killed $done_kills times in $rounds starts, every frame the same bits"
