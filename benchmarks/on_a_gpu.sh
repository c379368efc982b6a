#!/usr/bin/env bash
# All that has to be seen on a GPU, in one call of at most ten minutes; results go into files of the directory OUT.
#
#     benchmarks/on_a_gpu.sh OUT [PYTHON]
#
# PYTHON is one that has this project and what tests need; by default that of .venv. Each part has a time limit of its
# own, and a part that fails stops no other; the last line says which failed, and the exit status is their number.
set -uo pipefail
out=$(realpath -m "${1:?give a directory for the results}")
python=${2:-.venv/bin/python}
mkdir -p "$out"
cd "$(dirname "$0")/.."
failed=()

part() { # part NAME SECONDS COMMAND...: run a command; its output goes into OUT/NAME.txt
    local name=$1 seconds=$2 began=$SECONDS
    shift 2
    echo "== $name: $*" | tee "$out/$name.txt"
    if ! timeout --kill-after=10 "$seconds" "$@" >>"$out/$name.txt" 2>&1; then
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
gpu=(training.device=cuda "training.gpu=$model" numerics=fast sandbox.require=none tracking=none)
# The paper's images and batches; fewer of them, and a seventeenth of its candidates.
small=(experiment=paper_force llm=grammar data.images=600 search.generations=3 search.candidates=18 search.initial=6
    training.precision=tf32 training.epochs=3 executor.workers=4 executor.per_gpu=4 "store.root=$work/cache")

part tests 140 "$python" -m pytest -q -p no:cacheprovider -p no:benchmark -m gpu tests
part bench 140 "$python" -m benchmarks.gpu
part search 100 "$python" -m tacevo search "${small[@]}" "${gpu[@]}" "run.dir=$work/run"
part retrain 60 "$python" -m tacevo replay "$work/run" --retrain 5
part study 60 "$python" -m tacevo study "$work/run" elites=2 seeds=2 epochs=5
part shown 20 "$python" -m tacevo show "$work/run"
cp "$work/run/summary.md" "$work/run/ledger.jsonl" "$out" 2>/dev/null

echo "failed: ${failed[*]:-none}" | tee -a "$out/versions.txt"
exit "${#failed[@]}"
