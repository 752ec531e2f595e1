#!/bin/sh
# Makes .venv: finds Python 3.13, installs requirements.lock and requirements-nodeps.lock by hash,
# installs scenec editable. Does nothing when .venv already answers to the same lock files,
# pyproject.toml and place.
set -eu
cd "$(dirname "$0")/.."

say() { printf '%s\n' "== $*"; }

is_313() {
  "$1" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 13))' >/dev/null 2>&1
}

# Prints the first interpreter that really runs as Python 3.13. A pyenv shim may exist and fail, so
# each is tried, not only looked up.
find_python() {
  for candidate in "${PYTHON:-}" python3.13 python3 python; do
    [ -n "$candidate" ] || continue
    if is_313 "$candidate"; then command -v "$candidate"; return 0; fi
  done
  if command -v pyenv >/dev/null 2>&1; then
    for candidate in "$(pyenv root)"/versions/3.13*/bin/python3.13; do
      if is_313 "$candidate"; then printf '%s\n' "$candidate"; return 0; fi
    done
  fi
  if command -v uv >/dev/null 2>&1; then
    candidate=$(UV_PYTHON_DOWNLOADS=never uv python find --no-project --system 3.13 2>/dev/null) || candidate=
    if [ -n "$candidate" ] && is_313 "$candidate"; then printf '%s\n' "$candidate"; return 0; fi
  fi
  return 1
}

wanted="$(pwd) $(cat requirements.lock requirements-nodeps.lock pyproject.toml | cksum)"
stamp=.venv/scenec.stamp
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && is_313 .venv/bin/python; then
  exit 0
fi

# A venv does not survive a move: its scripts and the editable install name their folder.
if [ -e .venv ]; then
  if ! is_313 .venv/bin/python; then
    say "Removing .venv: its Python does not run, or is not 3.13"
    rm -rf .venv
  elif [ -f "$stamp" ] && [ "$(sed 's/ [0-9]* [0-9]*$//' "$stamp")" != "$(pwd)" ]; then
    say "Removing .venv: it was made in another folder"
    rm -rf .venv
  fi
fi
rm -f "$stamp"

if [ ! -e .venv ]; then
  if ! python=$(find_python); then
    cat >&2 <<'MESSAGE'
scenec needs Python 3.13, and none was found as python3.13, python3, python, in pyenv or in uv.
Install it in one of these ways, then run the same command again:
  Debian, Ubuntu    apt install python3.13 python3.13-venv
  macOS             brew install python@3.13
  pyenv             pyenv install 3.13
  uv                uv python install 3.13
or name an interpreter:  make demo PYTHON=path/to/python3.13
MESSAGE
    exit 1
  fi
  say "Making .venv with $python"
  if ! "$python" -m venv .venv >/dev/null 2>&1; then
    rm -rf .venv
    if ! command -v uv >/dev/null 2>&1; then
      printf '%s\n' "$python cannot make a virtual environment: its venv module or pip is missing." \
        "On Debian and Ubuntu: apt install python3.13-venv. Then run the same command again." >&2
      exit 1
    fi
    uv venv --quiet --seed --python "$python" .venv
  fi
fi

# Wheels only: building an sdist would fetch build tools that the lock does not pin. No dependencies
# beyond the locks: requirements.lock is complete, and requirements-nodeps.lock has the packages of
# whose dependencies pyproject.toml overrides some (Jupyter's server for a libOSMesa).
install() {
  if command -v uv >/dev/null 2>&1; then
    uv pip install --python .venv/bin/python --require-hashes --no-deps --only-binary :all: -r "$1"
  else
    .venv/bin/python -m pip install --disable-pip-version-check --require-hashes \
      --no-deps --only-binary :all: -r "$1"
  fi
}

say "Installing the packages of requirements.lock, each checked against its hash (about 1 GB, once)"
# First what compiles kernels: that is done while the rest, most of it renderers, arrives.
.venv/bin/python tools/core_requirements.py >.venv/core.txt
install .venv/core.txt
say "Installing scenec itself, editable"
.venv/bin/python -m pip install --disable-pip-version-check --quiet --no-index --no-deps \
  --no-build-isolation --editable .
say "Compiling the kernels beside the other downloads"
.venv/bin/python tools/warm_kernels.py &
warming=$!
trap 'kill $warming 2>/dev/null || true' EXIT
install requirements.lock
install requirements-nodeps.lock
.venv/bin/python -m tools.cfg_stub >/dev/null
say "Waiting for the kernels"
wait $warming || true
trap - EXIT

printf '%s\n' "$wanted" >"$stamp"
say "The environment is ready: .venv"
