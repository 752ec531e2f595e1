// Unpacks the npm package that tools/browser.sh got: unpack_browser.js FOLDER INTEGRITY.
// FOLDER holds the .tgz; afterwards it holds `chromium` and the libraries and fonts it needs.
const crypto = require("node:crypto");
const fs = require("node:fs");
const path = require("node:path");
const zlib = require("node:zlib");
const { execFileSync } = require("node:child_process");

const [folder, integrity] = process.argv.slice(2);
const archive = path.join(folder, fs.readdirSync(folder).find((name) => name.endsWith(".tgz")));
const digest = crypto.createHash("sha512").update(fs.readFileSync(archive)).digest("base64");
if (`sha512-${digest}` !== integrity) process.exit(1);
execFileSync("tar", ["--no-same-owner", "-xzf", archive, "-C", folder, "package/bin"]);
const packed = path.join(folder, "package", "bin");
for (const name of fs.readdirSync(packed)) {
  const plain = path.join(packed, name.replace(/\.br$/, ""));
  fs.writeFileSync(plain, zlib.brotliDecompressSync(fs.readFileSync(path.join(packed, name))));
  if (plain.endsWith(".tar")) execFileSync("tar", ["--no-same-owner", "-xf", plain, "-C", folder]);
}
fs.renameSync(path.join(packed, "chromium"), path.join(folder, "chromium"));
fs.chmodSync(path.join(folder, "chromium"), 0o755);
fs.rmSync(path.join(folder, "package"), { recursive: true });
fs.rmSync(archive);
// The package's own names folders of the service that it was made for. A relative folder of caches
// would be one below the working directory. FOLDER is named .new until it is whole.
fs.writeFileSync(
  path.join(folder, "fonts.conf"),
  `<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "fonts.dtd">
<fontconfig>
  <dir>/usr/share/fonts</dir>
  <dir prefix="relative">fonts</dir>
  <cachedir>${path.resolve(folder).replace(/\.new$/, "")}/cache</cachedir>
</fontconfig>
`,
);
