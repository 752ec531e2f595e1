#!/bin/sh
# Builds a wheel into dist/ for the Python of .venv and of each .venv-3.x (tools/pythons.sh), with the
# kernels of all cfgs that ship, compiled by that Python for this kind of CPU.
set -eu
cd "$(dirname "$0")/.."
.venv/bin/python -m tools.cfg_stub
trap 'rm -rf schemas/compiled' EXIT
for folder in .venv .venv-3.*; do
  [ -x "$folder/bin/python" ] || continue
  tag=$("$folder/bin/python" -c 'import sys; print("cp%d%d" % sys.version_info[:2])')
  echo "== Compiling the kernels of all cfgs that ship ($tag)"
  rm -rf schemas/compiled
  NUMBA_CACHE_DIR="build/kernels-$tag" SCENEC_CACHE='' "$folder/bin/python" tools/warm_kernels.py --all
  cp -r "build/kernels-$tag/scenec" schemas/compiled
  echo "== Building the wheel ($tag)"
  .venv/bin/python -m build --wheel --no-isolation -C--build-option=--python-tag="$tag"
done
