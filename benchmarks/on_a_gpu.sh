#!/usr/bin/env bash
# Check and time diffshade on a GPU: one command of at most eight minutes, from a machine with a driver and Python.
#
#     benchmarks/on_a_gpu.sh [--wheels FOLDER] [--rehearse]
#
# FOLDER holds the wheels of jax[cuda13] and of what pyproject.toml names, for a machine without a network; without it
# the Python at hand must have them. --rehearse takes small sizes, on whatever device there is.
set -euo pipefail
cd "$(dirname "$0")/.."
python=python3
if [ "${1-}" = --wheels ]; then
    [ -d "${2-}" ] || { echo "--wheels needs a folder of wheels; got '${2-}'." >&2; exit 2; }
    site="$(mktemp -d)"
    trap 'rm -rf "$site"' EXIT
    python3 -m venv "$site"
    "$site/bin/pip" install -q --no-index --find-links "$2" 'jax[cuda13]' '.'
    python="$site/bin/python"
    shift 2
fi
PYTHONPATH="$PWD:$PWD/benchmarks" timeout 480 "$python" benchmarks/on_a_gpu.py "$@"
