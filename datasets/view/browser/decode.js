// From an element's text to arrays. Decoded layers are kept while there is room.

const ROOM = 192 * 2 ** 20;
const kept = new Map();
let keptBytes = 0;

/** The lines of a frame's element: [JSON, base64, base64, ...]; nothing else is made of it yet. */
function lines(number) {
  const text = $(`f${number}`).content.textContent;
  const end = text.indexOf("\n");
  return { head: JSON.parse(end < 0 ? text : text.slice(0, end)), text, start: end + 1 };
}

function bytesOf(base64) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64);
  const binary = atob(base64);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Facts of a frame: size, stored size, K, pose, layers. */
function headOf(number) {
  return keep(`${number}`, () => {
    const { head } = lines(number);
    head.bytes = 2000;
    return head;
  });
}

/** One layer of a frame, decoded; a promise. Null where the frame has none. */
function layerOf(number, name) {
  return keep(`${number}/${name}`, async () => {
    const { head, text, start } = lines(number);
    const at = head.layers.findIndex((layer) => layer.name === name);
    if (at < 0) return null;
    let from = start;
    for (let i = 0; i < at; i++) from = text.indexOf("\n", from) + 1;
    const end = text.indexOf("\n", from);
    const bytes = bytesOf(text.slice(from, end < 0 ? undefined : end));
    return decoders[head.layers[at].code](bytes, head.layers[at], head);
  });
}

/** Least recently used go first. Promises are kept, too: nothing is decoded twice at a time. */
function keep(key, produce) {
  let entry = kept.get(key);
  if (entry) {
    kept.delete(key);
    kept.set(key, entry);
    return entry.value;
  }
  entry = { value: produce(), bytes: 0 };
  kept.set(key, entry);
  Promise.resolve(entry.value).then((value) => {
    if (!value || kept.get(key) !== entry) return;
    entry.bytes = value.bytes ?? 0;
    keptBytes += entry.bytes;
    for (const [old, other] of kept) {
      if (keptBytes <= ROOM) break;
      if (old === key || !other.bytes) continue;
      kept.delete(old);
      keptBytes -= other.bytes;
    }
  });
  return entry.value;
}

/** A plane of 16 bits from its differences (`layers.differences`). */
function unfold(raw, width, height) {
  const n = width * height;
  const codes = new Uint16Array(n);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      const folded = raw[i] | (raw[n + i] << 8);
      const left = x ? codes[i - 1] : 0;
      const upper = y ? codes[i - width] : 0;
      const corner = x && y ? codes[i - width - 1] : 0;
      codes[i] = ((folded >>> 1) ^ -(folded & 1)) + left + upper - corner;
    }
  }
  return codes;
}

/** An IEEE binary16 from the whole number that stands for it (`fields`). */
function half(code) {
  const bits = code & 0x8000 ? code & 0x7fff : ~code & 0xffff;
  const [exponent, fraction] = [(bits >>> 10) & 31, bits & 1023];
  const size = exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24;
  return bits & 0x8000 ? -size : size;
}

const decoders = {
  async jpeg(bytes, facts, head) {
    const image = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    return { code: "jpeg", image, bytes: 4 * head.stored[0] * head.stored[1] };
  },

  async ids(packed, facts, head) {
    const raw = await inflate(packed);
    const ids = new Uint32Array(raw.slice(0, 4 * facts.count).buffer);
    const kind = { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[facts.bytes];
    const places = new kind(raw.slice(4 * facts.count).buffer);
    return { code: "ids", ids, places, width: head.stored[0], height: head.stored[1], bytes: raw.length };
  },

  async steps(packed, facts, head) {
    const [width, height] = head.stored;
    const n = width * height;
    const codes = unfold(await inflate(packed), width, height);
    const layer = { code: "steps", codes, width, height, ...facts, bytes: 2 * n };
    const ratio = Math.log(facts.far / facts.near);
    layer.at = (i) => {
      const code = codes[i];
      if (code === 0) return Infinity;
      if (code === facts.top) return NaN;
      const part = (code - 1) / (facts.top - 2);
      return facts.even ? facts.near + part * (facts.far - facts.near) : facts.near * Math.exp(part * ratio);
    };
    layer.error = facts.even
      ? (facts.far - facts.near) / (2 * (facts.top - 2))
      : Math.expm1(ratio / (2 * (facts.top - 2)));
    return layer;
  },

  /** Values at a pixel: numbers, or null where one is none. */
  async halves(packed, facts, head) {
    const raw = await inflate(packed);
    const [width, height] = head.stored;
    const n = width * height;
    const planes = Array.from({ length: facts.planes }, (_, k) => unfold(raw.subarray(2 * n * k), width, height));
    const at = (i) => (planes[0][i] === 0xffff ? null : planes.map((codes) => half(codes[i])));
    return { code: "halves", planes, at, width, height, bytes: 2 * n * facts.planes };
  },

  async whole(packed, facts, head) {
    const [width, height] = head.stored;
    const codes = unfold(await inflate(packed), width, height);
    return { code: "whole", codes, top: facts.top, at: (i) => codes[i], width, height, bytes: 2 * codes.length };
  },

  async turns(packed, facts, head) {
    const codes = await inflate(packed);
    const [width, height] = head.stored;
    const n = width * height;
    for (let i = 0; i < 2 * n; i++) if (i % width) codes[i] += codes[i - 1];
    const at = (i) => {
      if (!codes[i] && !codes[n + i]) return null;
      let x = (codes[i] - 1) / 127 - 1;
      let y = (codes[n + i] - 1) / 127 - 1;
      const z = 1 - Math.abs(x) - Math.abs(y);
      if (z < 0) {
        [x, y] = [(1 - Math.abs(y)) * (x >= 0 ? 1 : -1), (1 - Math.abs(x)) * (y >= 0 ? 1 : -1)];
      }
      const length = Math.hypot(x, y, z);
      return [x / length, y / length, z / length];
    };
    return { code: "turns", codes, at, width, height, bytes: 2 * n };
  },

  async json(packed) {
    const raw = await inflate(packed);
    const table = JSON.parse(new TextDecoder().decode(raw));
    table.row = new Map(table.id.map((id, i) => [id, i]));
    table.bytes = 4 * raw.length;
    return table;
  },
};

/** The column (row) of the frame that a stored one is, exactly as `layers.taken` has it. */
const taken = (stored, size, full) => Math.floor(((2 * stored + 1) * full) / (2 * size));
/** The stored column (row) nearest to one of the frame. */
const storedAt = (place, size, full) => Math.min(size - 1, Math.max(0, Math.floor(((place + 0.5) * size) / full)));
