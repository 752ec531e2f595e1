#!/bin/sh
# Makes .venv: finds Python 3.12, 3.13 or 3.14, installs requirements.lock and
# requirements-nodeps.lock by hash, installs scenec editable. Does nothing when .venv already
# answers to the same lock files, pyproject.toml and place. With names of extras it installs what
# these need and no more; what is there stays.
set -eu
cd "$(dirname "$0")/.."

say() { printf '%s\n' "== $*"; }

# All but Cycles works with each of these; Blender's wheel is for 3.13 alone, hence first.
versions="3.13 3.14 3.12"

fits() {
  "$1" -c 'import sys; sys.exit("%d.%d" % sys.version_info[:2] not in sys.argv[1:])' $versions >/dev/null 2>&1
}

# Prints the first interpreter that really runs as one of these. A pyenv shim may exist and fail, so
# each is tried, not only looked up.
find_python() {
  if [ -n "${PYTHON:-}" ]; then
    if fits "$PYTHON"; then command -v "$PYTHON"; return 0; fi
    say "PYTHON=$PYTHON does not run, or is none of $versions; looking for another" >&2
  fi
  for version in $versions; do
    for candidate in "python$version" "$HOME/.local/bin/python$version" \
      $(command -v pyenv >/dev/null 2>&1 && ls -d "$(pyenv root)/versions/$version"*/bin/"python$version" 2>/dev/null) \
      $(command -v uv >/dev/null 2>&1 && UV_PYTHON_DOWNLOADS=never uv python find --no-project --system "$version" 2>/dev/null); do
      if fits "$candidate"; then command -v "$candidate"; return 0; fi
    done
  done
  for candidate in python3 python; do
    if fits "$candidate"; then command -v "$candidate"; return 0; fi
  done
  return 1
}

wanted="$(pwd) $(cat requirements.lock requirements-nodeps.lock pyproject.toml | cksum)"
stamp=.venv/scenec.stamp
if [ -f "$stamp" ] && fits .venv/bin/python; then
  case "$(cat "$stamp")" in "$wanted" | "$wanted for $*") exit 0 ;; esac
fi

# A venv does not survive a move: its scripts and the editable install name their folder.
if [ -e .venv ]; then
  if ! fits .venv/bin/python; then
    say "Removing .venv: its Python does not run, or is none of $versions"
    rm -rf .venv
  elif [ -f "$stamp" ] && [ "$(sed 's/ [0-9]* [0-9]*\( for .*\)\{0,1\}$//' "$stamp")" != "$(pwd)" ]; then
    say "Removing .venv: it was made in another folder"
    rm -rf .venv
  fi
fi
rm -f "$stamp"

if [ ! -e .venv ]; then
  if ! python=$(find_python); then
    bring="pip install uv && uv"
    command -v pipx >/dev/null 2>&1 && bring="pipx run uv"
    command -v uv >/dev/null 2>&1 && bring=uv
    cat >&2 <<MESSAGE
scenec needs Python 3.12, 3.13 or 3.14, and none was found by these names, in pyenv or in uv.
This command brings one; then run the same command again:
  $bring python install 3.13
Or name an interpreter: make demo PYTHON=path/to/python3.13
MESSAGE
    exit 1
  fi
  say "Making .venv with $python"
  if ! "$python" -m venv .venv >/dev/null 2>&1; then
    rm -rf .venv
    if ! command -v uv >/dev/null 2>&1; then
      printf '%s\n' "$python cannot make a virtual environment: its venv module or pip is missing." \
        "On Debian and Ubuntu: apt install the package of its venv module, such as python3.13-venv. Then run the same command again." >&2
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

say "Installing packages of requirements.lock, each checked against its hash (once)"
# First what compiles kernels: that is done while the rest, most of it renderers, arrives.
.venv/bin/python tools/locked.py >.venv/core.txt
install .venv/core.txt
say "Installing scenec itself, editable"
.venv/bin/python -m pip install --disable-pip-version-check --quiet --no-index --no-deps \
  --no-build-isolation --editable .
say "Compiling the kernels beside the other downloads"
.venv/bin/python tools/warm_kernels.py &
warming=$!
trap 'kill $warming 2>/dev/null || true' EXIT
if [ $# -gt 0 ]; then
  .venv/bin/python tools/locked.py "$@" >.venv/extras.txt
  install .venv/extras.txt
  wanted="$wanted for $*"
else
  install requirements.lock
  install requirements-nodeps.lock
fi
.venv/bin/python -m tools.cfg_stub >/dev/null
say "Waiting for the kernels"
wait $warming || true
trap - EXIT

printf '%s\n' "$wanted" >"$stamp"
say "The environment is ready: .venv"
