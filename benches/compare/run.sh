#!/usr/bin/env bash
# Renders scenes with majorant, Mitsuba and Cycles in turn and prints the tables.
#
#   RUNNERS=DIR SCENES=DIR RUNS=DIR [PYTHON=python3] [ROUNDS=4] [SPP=16] [REF_SPP=64] \
#       run.sh s1_cloud s2_smoke …
#
# Turns are short and alternate, so that a busy or slow moment of the machine hits all alike.
# SPP below 4 is too little for the tables.
# Rounds have seeds 1, 2, …; then each renderer but majorant adds two blocks of REF_SPP samples
# with seeds 100 and 101, which form its reference. REF_SPP=0 leaves them out. See README.md.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
: "${RUNNERS:?folder with run_mitsuba.py, run_cycles.py and compare.py}"
: "${SCENES:?folder with the scenes: json, vdb and dense npz files}"
: "${RUNS:?folder for images and runs.jsonl}"
python=${PYTHON:-python3}
rounds=${ROUNDS:-4} spp=${SPP:-16} ref_spp=${REF_SPP:-64}
[ $# -gt 0 ] || { echo "run.sh: name at least one scene" >&2; exit 2; }
mkdir -p "$RUNS"

run() { # runner, scene, spp specification, options
    local runner=$1 scene=$2 spec=$3
    shift 3
    "$python" -B "$runner" "$SCENES/$scene.json" "$RUNS" --spp "$spec" "$@" >>"$RUNS/log" 2>&1 ||
        { echo "run.sh: $runner failed on $scene:" >&2; tail -n 5 "$RUNS/log" >&2; exit 1; }
    echo "$(date +%T) $(basename "$runner") $scene $spec"
}

mitsuba() { run "$RUNNERS/run_mitsuba.py" "$1" "$2" --variant scalar_rgb --integrator volpath; }
cycles() { run "$RUNNERS/run_cycles.py" "$1" "$2"; }

for round in $(seq "$rounds"); do
    for scene in "$@"; do
        run "$here/run_majorant.py" "$scene" "${spp}x1@$round"
        mitsuba "$scene" "${spp}x1@$round"
        cycles "$scene" "${spp}x1@$round"
    done
done
if [ "$ref_spp" -gt 0 ]; then
    for scene in "$@"; do
        mitsuba "$scene" "${ref_spp}x2@100"
        cycles "$scene" "${ref_spp}x2@100"
    done
fi
"$python" -B "$RUNNERS/compare.py" "$RUNS" "$SCENES" --only "$(IFS=,; echo "$*")"
