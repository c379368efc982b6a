#!/usr/bin/env bash
# All that has to be seen on a GPU, in one call of at most ten minutes; results go into files of the directory OUT.
#
#     benchmarks/on_a_gpu.sh OUT [PYTHON]
#     python -m benchmarks.gpu_rows OUT       # afterwards, anywhere: the rows for docs/scale.md
#
# PYTHON is one that has this project and what tests need; by default that of .venv. The parts stand in the order of
# their worth. Each has a time limit of its own, none begins when the ten minutes are over, and a part that fails stops
# no other; the last line says which failed, and the exit status is their number.
set -uo pipefail
out=$(realpath -m "${1:?give a directory for the results}")
python=${2:-.venv/bin/python}
total=${TOTAL_SECONDS:-580}
mkdir -p "$out"
cd "$(dirname "$0")/.."
failed=()

part() { # part NAME SECONDS COMMAND...: run a command; its output goes into OUT/NAME.txt
    local name=$1 seconds=$2 began=$SECONDS left=$((total - SECONDS))
    shift 2
    if ((left < 5)); then
        failed+=("$name: no time left")
        return
    fi
    echo "== $name: $*" | tee "$out/$name.txt"
    if ! timeout --kill-after=5 "$((seconds < left ? seconds : left))" "$@" >>"$out/$name.txt" 2>&1; then
        failed+=("$name")
    fi
    echo "took $((SECONDS - began)) s" | tee -a "$out/$name.txt"
    tail -n 12 "$out/$name.txt"
}

model=$("$python" -c 'import torch; print(torch.cuda.get_device_name(0))' 2>"$out/versions.txt") || { echo "no CUDA device that torch can use"; exit 2; }
"$python" -c 'import torch; print(torch.__version__, torch.version.cuda)' | tee "$out/versions.txt"
nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv >>"$out/versions.txt"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
tacevo=("$python" -m tacevo)
gpu=(training.device=cuda "training.gpu=$model" numerics=fast tracking=none)
# The paper's images and batches, fewer of them, and 61 of its candidates; tf32 by default, and as many at once as fit.
paper=(experiment=paper_force llm=grammar "${gpu[@]}" sandbox.require=none executor.workers=8)
search=("${paper[@]}" data.images=1000 training.epochs=5 search.generations=2 search.candidates=25 search.initial=10)
small=("${paper[@]}" data.image_size=64 data.images=300 training.epochs=2 search.generations=2 search.candidates=8
    search.initial=4)

killed() { # a search is killed in its middle, goes on, and has the bytes of one that was not, with another number of workers
    "${tacevo[@]}" search "${small[@]}" "store.root=$work/one" "run.dir=$work/whole" executor.workers=1 || return
    timeout --signal=KILL 12 "${tacevo[@]}" search "${small[@]}" "store.root=$work/two" "run.dir=$work/killed" executor.workers=3
    test -f "$work/killed/summary.md" && echo "it had ended before it was killed: nothing was shown of that"
    "${tacevo[@]}" search "${small[@]}" "store.root=$work/two" "run.dir=$work/killed" executor.workers=3 || return
    cmp "$work/whole/ledger.jsonl" "$work/killed/ledger.jsonl" && echo "equal bytes: 1 worker, and 3 workers after a kill"
}

walls() { # the same small search behind the kernel's walls; run.json says what held
    "${tacevo[@]}" search "${small[@]}" sandbox.require=kernel "store.root=$work/walled" "run.dir=$work/walls" || return
    "$python" -c 'import json, sys; print(json.dumps(json.load(open(sys.argv[1]))["confinement"], indent=1))' "$work/walls/run.json"
}

# A function runs in this shell's arrays, so it is given to `part` as a command of a shell that has them.
inside() { declare -p tacevo small paper work python; declare -f "$1"; echo "$1"; }

part tests 140 "$python" -m pytest -v -n 4 -p no:cacheprovider -p no:benchmark -m gpu tests
part start 20 "$python" -m benchmarks.gpu_start
part bench 110 "$python" -m benchmarks.gpu
part search 100 "${tacevo[@]}" search "${search[@]}" "store.root=$work/cache" "run.dir=$work/run"
part retrain 40 "${tacevo[@]}" replay "$work/run" --retrain 5
part walls 45 bash -c "$(inside walls)"
part estimate 45 "${tacevo[@]}" search --estimate "${paper[@]}"
part estimate-before 45 "${tacevo[@]}" search --estimate "${paper[@]}" training.captured=false executor.workers=2 executor.per_gpu=2
part killed 60 bash -c "$(inside killed)"
part precision 60 "$python" -m benchmarks.gpu_precision
part study 40 "${tacevo[@]}" study "$work/run" elites=4 seeds=2 epochs=5 executor.workers=8
part shown 10 "${tacevo[@]}" show "$work/run"
cp "$work/run/summary.md" "$work/run/ledger.jsonl" "$out" 2>/dev/null

echo "failed: ${failed[*]:-none}" | tee -a "$out/versions.txt"
exit "${#failed[@]}"
