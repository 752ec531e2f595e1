#!/bin/sh
# Gets a headless Chromium for the tests of `scenec view` into .venv/browser, where there is none:
# the one that the npm package @sparticuz/chromium carries, checked against its hash. Never fails:
# without a browser those tests are skipped, and say so.
set -eu
cd "$(dirname "$0")/.."

package=@sparticuz/chromium
version=147.0.0
integrity=sha512-4ZKeAQQa8up2mt675qSitztLdbQrlf8BKdC5naeap+5Mv1OV1OlJdPoU+EJC/p5sQUJUQmN4r+q5+EhaaOUHpQ==
folder=.venv/browser

say() { printf '%s\n' "== $*"; }

[ -z "${SCENEC_BROWSER:-}" ] || exit 0
for name in chromium chromium-browser google-chrome google-chrome-stable; do
  if command -v "$name" >/dev/null 2>&1; then exit 0; fi
done
if [ -f "$folder/stamp" ] && [ "$(cat "$folder/stamp")" = "$version" ]; then exit 0; fi
if ! command -v npm >/dev/null 2>&1 || ! command -v node >/dev/null 2>&1; then
  say "No Chromium and no npm to get one: tests in a browser will be skipped"
  exit 0
fi
if [ "$(uname -sm)" != "Linux x86_64" ]; then
  say "No Chromium, and $package is for Linux on x86-64: tests in a browser will be skipped"
  exit 0
fi

say "Getting Chromium for the tests of the page (65 MB, once)"
rm -rf "$folder" "$folder.new"
mkdir -p "$folder.new"
trap 'rm -rf "$folder.new"' EXIT
if ! npm pack "$package@$version" --silent --pack-destination "$folder.new" >/dev/null 2>&1; then
  say "It cannot be had: tests in a browser will be skipped"
  exit 0
fi
if ! node tools/unpack_browser.js "$folder.new" "$integrity"; then
  say "It is not what was pinned: tests in a browser will be skipped"
  exit 0
fi
printf '%s\n' "$version" >"$folder.new/stamp"
mv "$folder.new" "$folder"
