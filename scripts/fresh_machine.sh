#!/usr/bin/env bash
# A fresh machine, as near as one machine can play it: a clean clone, a new virtual environment, empty caches, and
# README's two commands, timed. Then the wheel and the sdist: built, checked, and the wheel installed and run outside
# the checkout.
#
#   scripts/fresh_machine.sh [--readme] [--wheel] [--python PYTHON] [--constraint FILE] [--site VENV]
#
# Without --readme or --wheel both parts run. --constraint is handed to pip (to choose a CPU-only torch, for example).
# --site VENV lets the wheel's environment see that one's packages instead of downloading them again.
set -euo pipefail
python=python3 constraint="" site="" readme=0 wheel=0
while [ $# -gt 0 ]; do
    case "$1" in
    --readme) readme=1 ;;
    --wheel) wheel=1 ;;
    --python) python=$2 && shift ;;
    --constraint) constraint=$(realpath "$2") && shift ;;
    --site) site=$("$2/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))') && shift ;;
    *) echo "unknown option $1" >&2 && exit 2 ;;
    esac
    shift
done
[ $readme = 0 ] && [ $wheel = 0 ] && readme=1 wheel=1

checkout=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# Nothing cached: pip, Numba, matplotlib and panobench's own rooms all look below these.
export HOME="$work/home" XDG_CACHE_HOME="$work/cache" NUMBA_CACHE_DIR="$work/numba" PIP_NO_CACHE_DIR=1
export PANOBENCH_CACHE="$work/rooms"
unset PYTHONPATH PANOBENCH_DATA PANOBENCH_TEST_DATA
mkdir -p "$HOME"
[ -n "$constraint" ] && export PIP_CONSTRAINT="$constraint"

timed() { # WHAT COMMAND...
    local what=$1 begin end
    shift
    begin=$(date +%s.%N)
    "$@"
    end=$(date +%s.%N)
    awk -v w="$what" -v b="$begin" -v e="$end" 'BEGIN { printf "%-44s %8.1f s\n", w, e - b }'
}

"$python" --version
git clone -q "$checkout" "$work/clone"

if [ $readme = 1 ]; then
    cd "$work/clone"
    # README's commands are taken from README, so that what is timed is what it says; python3 becomes --python.
    commands=$(awk '/^```sh$/ { on = 1; next } /^```$/ { on = 0 } on' README.md | grep -E '^python3 -m venv .*panobench run|^\.venv/bin/panobench report')
    [ "$(printf '%s\n' "$commands" | wc -l)" = 2 ] || { echo "README has not the two commands" >&2 && exit 1; }
    number=0
    while IFS= read -r line; do
        number=$((number + 1))
        timed "README command $number" bash -c "${line/#python3/$python}"
    done <<<"$commands"
    [ -s report.html ] && [ -s runs/first/run.json ]
    timed "the same run, everything cached" .venv/bin/panobench run --quiet --out runs/second
fi

if [ $wheel = 1 ]; then
    "$python" -m venv "$work/tools"
    "$work/tools/bin/pip" install -q build twine
    cd "$work/clone"
    timed "wheel and sdist" bash -c '"$1/tools/bin/python" -m build --outdir "$1/dist" . >"$1/build.log" 2>&1 ||
        { tail -20 "$1/build.log" >&2; exit 1; }' build "$work"
    "$work/tools/bin/twine" check --strict "$work"/dist/*
    cd "$work"
    "$python" -m venv "$work/venv"
    if [ -n "$site" ]; then
        echo "$site" >"$("$work/venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/site.pth"
        timed "pip install the wheel, without downloads" "$work/venv/bin/pip" install -q --no-deps --force-reinstall "$work"/dist/*.whl
    else
        timed "pip install the wheel" "$work/venv/bin/pip" install -q "$work"/dist/*.whl
    fi
    where=$("$work/venv/bin/python" -c 'import panobench; print(panobench.__file__)')
    case "$where" in "$work/venv"/*) ;; *) echo "imported from $where" >&2 && exit 1 ;; esac
    # Templates and data: a report, a plugin package, a built-in calibration, a room.
    timed "panobench run, from the wheel" "$work/venv/bin/panobench" run --sequence tiny --width 128 --max-frames 14 --out run --quiet
    "$work/venv/bin/panobench" report run -o report.html
    "$work/venv/bin/panobench" plugin new demo --kind method --in "$work" >/dev/null
    "$work/venv/bin/panobench" convert rooms --sequence tiny --to pal --width 160 --every 20 --out pal --quiet
    "$work/venv/bin/panobench" list >/dev/null
    tar -tzf "$work"/dist/*.tar.gz >"$work/sdist.txt"
    for file in LICENSE CHANGELOG.md CITATION.cff CONTRIBUTING.md tests/conftest.py fuzz/campaign.py; do
        grep -q "/$file\$" "$work/sdist.txt" || { echo "the sdist lacks $file" >&2 && exit 1; }
    done
fi
echo "fresh machine: ok"
