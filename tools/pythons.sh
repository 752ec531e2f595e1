#!/bin/sh
# Makes .venv-3.x with scenec and the extras that are named, for each Python that it works with, is
# found here (by name, in pyenv, in uv) and is not that of .venv. Says which are not found.
set -eu
cd "$(dirname "$0")/.."
uv=.venv/bin/uv
own=$(.venv/bin/python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
for version in 3.12 3.13 3.14; do
  [ "$version" != "$own" ] || continue
  python=
  for candidate in "python$version" "$HOME/.pyenv/versions/$version"*/bin/"python$version" \
    "$(UV_PYTHON_DOWNLOADS=never $uv python find --no-project --system "$version" 2>/dev/null || true)"; do
    if [ -n "$candidate" ] && "$candidate" -c '' >/dev/null 2>&1; then python=$candidate; break; fi
  done
  if [ -z "$python" ]; then
    echo "== Python $version is not found here; this brings it: uv python install $version"
    continue
  fi
  folder=.venv-$version
  echo "== Installing scenec into $folder"
  $uv venv --quiet --seed --clear --python "$python" "$folder"
  .venv/bin/python tools/locked.py "$@" >"$folder/lock.txt"
  $uv pip install --quiet --python "$folder/bin/python" --require-hashes --no-deps --only-binary :all: -r "$folder/lock.txt"
  $uv pip install --quiet --python "$folder/bin/python" --no-deps --no-build-isolation --editable .
done
