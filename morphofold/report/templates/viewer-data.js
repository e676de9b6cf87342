// Reads what viewer.py wrote: text to bytes to codes to numbers.
"use strict";
async function inflate(id) {
  const text = atob(document.getElementById(id).textContent), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);           // Uint8Array.from is many times slower
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
function decode(raw, a) {
  const out = a.bytes === 2 ? new Uint16Array(a.n) : new Uint32Array(a.n);
  for (let i = 0; i < a.n; i++) {
    let z = 0;
    for (let b = 0; b < a.bytes; b++) z |= raw[a.at + b * a.n + i] << (8 * b);
    z >>>= 0;
    out[i] = ((z >>> 1) ^ -(z & 1)) + (i >= a.stride ? out[i - a.stride] : 0);
  }
  return out;
}
function onDemand(names, make) {               // an object whose values are computed when they are first read
  const out = {};
  for (const name of names) Object.defineProperty(out, name, { configurable: true, get() {
    const value = make(name);
    Object.defineProperty(out, name, { value });
    return value;
  } });
  return out;
}
function toMm(codes, box) {
  const out = new Float32Array(codes.length), step = box.edge / 65535;
  for (let i = 0; i < codes.length; i++) out[i] = box.low[i % 3] + codes[i] * step;
  return out;
}
function vertexNormals(p, f) {
  const n = new Float32Array(p.length);
  for (let t = 0; t < f.length; t += 3) {
    const a = 3 * f[t], b = 3 * f[t + 1], c = 3 * f[t + 2];
    const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const i of [a, b, c]) { n[i] += x; n[i + 1] += y; n[i + 2] += z; }
  }
  for (let i = 0; i < n.length; i += 3) {
    const s = 1 / (Math.hypot(n[i], n[i + 1], n[i + 2]) || 1);
    n[i] *= s; n[i + 1] *= s; n[i + 2] *= s;
  }
  return n;
}
