// What the ground is to a vehicle, and where it lies on a body; the preview has this file, too.

/** A site of its facts and its codes: a byte a cell and layer, then heights of two bytes. */
function siteOf(facts, bytes) {
  const cells = facts.size[0] * facts.size[1];
  const layers = facts.layers.map((layer, i) => {
    const codes = bytes.subarray(i * cells, (i + 1) * cells);
    // 0 is nothing there; the last color goes on.
    return { ...layer, codes, kind: (code) => Math.min(layer.names.length, Math.floor((code - 1) / layer.band) + 1) - 1 };
  });
  const rest = bytes.subarray(layers.length * cells);
  const [low, high] = facts.heights ?? [0, 0];
  const height = (k) => {
    const code = facts.heights ? rest[2 * k] + 256 * rest[2 * k + 1] : 0;
    return code ? low + ((code - 1) / 65534) * (high - low) : NaN;
  };
  return { ...facts, layers, height };
}

/** Cell over a place; -1 beyond the border. */
function siteCell(site, x, y) {
  const [i, j] = [x, y].map((v, axis) => Math.floor((v - site.corner[axis] + site.cell / 2) / site.step));
  return i >= 0 && j >= 0 && i < site.size[0] && j < site.size[1] ? j * site.size[0] + i : -1;
}

/** A layer in its colors, north up. */
function sitePicture(site, layer) {
  const [nx, ny] = site.size;
  const canvas = new OffscreenCanvas(nx, ny);
  const image = new ImageData(nx, ny);
  for (let y = 0; y < ny; y++) {
    for (let x = 0; x < nx; x++) {
      const code = layer.codes[y * nx + x];
      if (code) image.data.set([...layer.colors[layer.kind(code)], 255], 4 * ((ny - 1 - y) * nx + x));
    }
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

/** Latitude and longitude in degrees, as Georeference.latitude_longitude has them. */
function placeAt(place, x, y) {
  const [ex, ey, nx, ny] = place.east_north;
  const [east, north] = [ex * x + ey * y, nx * x + ny * y];
  const turn = Math.PI / 180;
  const [sp, cp] = [Math.sin(place.latitude_deg * turn), Math.cos(place.latitude_deg * turn)];
  const [sl, cl] = [Math.sin(place.longitude_deg * turn), Math.cos(place.longitude_deg * turn)];
  const radii = [place.semi_major_m, place.semi_major_m, place.semi_minor_m];
  const up = [cp * cl, cp * sl, sp];
  const scale = 1 / Math.hypot(radii[0] * cp, radii[2] * sp);
  const flat = [-sl * east - sp * cl * north, cl * east - sp * sl * north, cp * north];
  const from = flat.map((v, i) => radii[i] * radii[i] * up[i] * scale + v);
  const sum = (term) => term(0) + term(1) + term(2);
  const a = sum((i) => (up[i] / radii[i]) ** 2);
  const b = sum((i) => (up[i] * from[i]) / radii[i] ** 2);
  const c = sum((i) => (flat[i] / radii[i]) ** 2);
  const t = -c / (b + Math.sqrt(b * b - a * c));
  const [px, py, pz] = from.map((v, i) => v + t * up[i]);
  return [Math.atan2(pz, (radii[2] / radii[0]) ** 2 * Math.hypot(px, py)) / turn, Math.atan2(py, px) / turn];
}

/** What is up on a map whose +y is: where a place's plane is turned, +y is not north. */
function upward(place) {
  const [ex, ey, nx, ny] = place?.east_north ?? [1, 0, 0, 1];
  const sign = Math.sign(ex * ny - ey * nx);
  const north = (Math.atan2(-ey * sign, ex * sign) * 180) / Math.PI;
  return Math.abs(north) < 0.05 ? "north up" : `+y up, north at ${((north + 360) % 360).toFixed(1)}° from it, clockwise`;
}

/** What there is at a place, in words. */
function siteText(site, x, y) {
  const k = siteCell(site, x, y);
  const parts = [];
  const z = k < 0 ? NaN : site.height(k);
  if (Number.isFinite(z)) parts.push(`height ${z.toFixed(2)} m`);
  for (const layer of site.layers) {
    const code = k < 0 ? 0 : layer.codes[k];
    if (code) parts.push(layer.step ? `${layer.name} ${((code - 1) * layer.step).toFixed(1)}°` : layer.names[layer.kind(code)]);
  }
  if (site.place) {
    const [latitude, longitude] = placeAt(site.place, x, y);
    // A step of the last digit is 3 mm on the Moon.
    if (Number.isFinite(latitude)) parts.push(`latitude ${latitude.toFixed(7)}°, longitude ${longitude.toFixed(7)}°`);
  }
  return parts.join(", ");
}
