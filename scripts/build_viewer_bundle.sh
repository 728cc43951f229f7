#!/usr/bin/env bash
# Rebuilds jaxmocap/viewer/three.bundle.js (the parts of three.js that the page uses) and its licence beside it.
# Needs node 18 or later with npm. Versions are pinned in scripts/viewer_bundle/package.json.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
target=$(cd "$here/../jaxmocap/viewer" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$here"/viewer_bundle/* "$work"
cd "$work"
npm install --no-audit --no-fund --no-package-lock --ignore-scripts
node node_modules/esbuild/install.js
node_modules/.bin/esbuild entry.js --bundle --minify --format=iife --global-name=JaxmocapThree --target=es2020 \
    --legal-comments=none --banner:js="$(printf '/* three.js\n\n%s\n*/' "$(cat node_modules/three/LICENSE)")" --outfile=three.bundle.js
if grep -qi '</script\|<!--' three.bundle.js; then
    echo "the bundle holds a text that would end the script element it stands in" >&2
    exit 1
fi
cp three.bundle.js "$target/three.bundle.js"
cp node_modules/three/LICENSE "$target/three.LICENSE.txt"
wc -c "$target/three.bundle.js"
