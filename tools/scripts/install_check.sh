#!/usr/bin/env bash
# install_check.sh VERSION...: build a wheel, install it into a fresh environment of each Python
# version that this machine has, all at once, and try the quick commands there. Pins are those of
# constraints.txt.
set -euo pipefail
cd "$(dirname "$0")/../.."
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
TIMEFORMAT="  %1R s, of the processor %1U s"

python_of() { # VERSION: a Python of that version, of the path or of pyenv; nothing if there is none
  local found
  for found in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1".*/bin/python; do
    if "$found" -c "" 2>/dev/null; then
      echo "$found"
      return
    fi
  done
}

try() { # VERSION PYTHON: install and try the commands
  echo "Python $1: pip install"
  "$2" -m venv "$work/$1"
  time "$work/$1/bin/pip" install --quiet --no-compile --disable-pip-version-check \
    --constraint constraints.txt "$work"/*.whl
  tools/scripts/try_commands.sh "$work/$1/bin" --quick
}

python3 -m pip wheel --quiet --no-deps --wheel-dir "$work" .
tried=()
for version in "$@"; do
  python="$(python_of "$version")"
  if [ -n "$python" ]; then
    try "$version" "$python" >"$work/$version.log" 2>&1 &
    tried+=("$version $!")
  else
    echo "Python $version is not on this machine."
  fi
done
failed=$((${#tried[@]} == 0))
for each in "${tried[@]}"; do
  wait "${each#* }" || failed=1
  cat "$work/${each% *}.log"
done
exit "$failed"
