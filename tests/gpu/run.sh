#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The GPU check in one call: compiles gsplat's kernels, runs the tests marked gpu, measures, writes benchmarks/results/<gpu>.json.
#
#   tests/gpu/run.sh [--wheels DIR] [--count 300000] [--iterations 7000] [--paper]
#
# --paper also runs the paper's presets on the smallest studio, with planted networks and few steps, on this GPU.
# It uses $PYTHON (python3) with its torch. What that python lacks is taken from the wheels in DIR and nothing is fetched; gsplat's wheel is
# the least that belongs there. Kernels are compiled by nvcc for the GPU at hand, once, into $TORCH_EXTENSIONS_DIR or torch's own folder.
set -euo pipefail

python=${PYTHON:-python3}
wheels=
options=()
paper=
while (($#)); do
  case $1 in
    --wheels) wheels=$(realpath "${2:?tests/gpu/run.sh: --wheels needs a folder}"); shift 2 ;;
    --paper) paper=1; shift ;;
    --count | --iterations) options+=("$1" "${2:?tests/gpu/run.sh: $1 needs a number}"); shift 2 ;;
    *) echo "tests/gpu/run.sh: there is no option $1; see the head of the file" >&2; exit 2 ;;
  esac
done
cd "$(dirname "$0")/../.."

fail() {
  echo "tests/gpu/run.sh: $1" >&2
  exit 1
}

command -v nvidia-smi > /dev/null && nvidia-smi -L > /dev/null 2>&1 || fail "no NVIDIA GPU answers on this machine (nvidia-smi); nothing was measured"
command -v nvcc > /dev/null || fail "nvcc is not on the PATH; gsplat's kernels are compiled with it, so install a CUDA toolkit"

export PYTHONPATH=$PWD/workflow:$PWD${PYTHONPATH:+:$PYTHONPATH} PYTHONUNBUFFERED=1
if [[ -n $wheels ]]; then
  site=$(mktemp -d)
  trap 'rm -rf "$site"' EXIT
  PIP_ROOT_USER_ACTION=ignore "$python" -m pip install --quiet --no-index --no-deps --no-compile --no-cache-dir --target "$site" "$wheels"/*.whl \
    || fail "the wheels in $wheels cannot be installed into this python; are they for its version and this machine?"
  export PYTHONPATH=$site:$PYTHONPATH
fi
missing=$("$python" - ${paper:+snakemake OpenEXR psutil} << 'END'
import sys
from importlib.util import find_spec

needed = ["torch", "gsplat", "numba", "numpy", "scipy", "cv2", "av", "yaml", "tqdm", "jaxtyping", "rich", "ninja", "kornia", "pytest", "pytest_timeout"]
print(" ".join(name for name in (*needed, *sys.argv[1:]) if find_spec(name) is None))
END
)
[[ -z $missing ]] || fail "$python does not find: $missing; put their wheels into a folder and give it with --wheels"

TORCH_CUDA_ARCH_LIST=${TORCH_CUDA_ARCH_LIST:-$("$python" -c 'import torch; print("%d.%d" % torch.cuda.get_device_capability())')}
export TORCH_CUDA_ARCH_LIST MAX_JOBS=${MAX_JOBS:-$(nproc)}
echo "compiling gsplat for compute capability $TORCH_CUDA_ARCH_LIST with $MAX_JOBS jobs"
"$python" -c 'from gsplat.cuda._backend import _C; raise SystemExit(_C is None)' \
  || fail "gsplat's kernels could not be compiled; VERBOSE=1 tests/gpu/run.sh shows what nvcc says"
"$python" -m benchmarks.gpu "${options[@]}"
[[ -z $paper ]] || "$python" -m benchmarks.gpu --paper
