// Draws every surface of the page in one WebGL2 canvas, one panel each, cameras linked.
// Data come from <script type="text/plain" id="data-N"> blocks written by viewer.py (viewer-data.js); nothing is fetched.
(async () => {
const root = document.documentElement;
const stage = document.getElementById("stage");
if (!stage) return;
const config = JSON.parse(document.getElementById("viewer-config").textContent);
const $ = (id) => document.getElementById(id);
const fail = (why) => {
  root.dataset.viewer = "failed: " + why;
  $("viewer").classList.add("failed");
  $("viewer-failure").textContent = "The interactive view is not available here (" + why + "). The pictures below show the same surfaces.";
};

// ---- cameras: rows of R are the screen's right, up and towards-the-viewer axes in brain coordinates -----------
// Coordinates are right, anterior, superior. A left hemisphere is seen laterally from -x, a right one from +x.
const VIEWS = {
  lateral: (h) => h === "rh" ? [0, 1, 0, 0, 0, 1, 1, 0, 0] : [0, -1, 0, 0, 0, 1, -1, 0, 0],
  medial: (h) => VIEWS.lateral(h === "rh" ? "lh" : "rh"),
  top: () => [1, 0, 0, 0, 1, 0, 0, 0, 1],
  bottom: () => [-1, 0, 0, 0, 1, 0, 0, 0, -1],
  front: () => [-1, 0, 0, 0, 0, 1, 0, 1, 0],
};
function turn(R, about, angle) {            // rotate the object about a screen axis: 0 right, 1 up, 2 viewer
  const c = Math.cos(angle), s = Math.sin(angle), i = (about + 1) % 3, j = (about + 2) % 3, out = R.slice();
  for (let k = 0; k < 3; k++) {
    out[3 * i + k] = c * R[3 * i + k] - s * R[3 * j + k];
    out[3 * j + k] = s * R[3 * i + k] + c * R[3 * j + k];
  }
  return out;
}
const state = { map: config.maps[0] ? config.maps[0].key : "", surface: document.querySelector("input[name=surface]:checked").value, zoom: 1, pan: [0, 0], fit: false, view: "lateral",
  crests: false, hinges: false, borders: false, side: "both", g: Infinity };
const limits = Object.fromEntries(config.maps.map((m) => [m.key, m.limits.slice()]));

// ---- GL ---------------------------------------------------------------------------------------------------
const canvas = $("canvas");
const gl = window.WebGL2RenderingContext && canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, alpha: false });
if (!gl) return fail("no WebGL 2");
if (!window.DecompressionStream) return fail("no DecompressionStream");
const VERTEX = `#version 300 es
layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in float code;
uniform mat3 R; uniform vec3 centre; uniform vec2 pan, scale; uniform float depth;
out vec3 n; out float value, known;
void main() {
  vec3 p = R * (position - centre);
  gl_Position = vec4((p.xy + pan) * scale, -p.z / depth, 1.0);
  n = R * normal; known = code < 65534.5 ? 1.0 : 0.0; value = known * code;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n; in float value, known; out vec4 colour;
uniform sampler2D table; uniform vec2 range, limit; uniform vec3 missing, bare; uniform bool coloured;
void main() {
  vec3 base = bare;
  if (coloured) {
    float v = range.x + value / max(known, 1e-4) / 65534.0 * (range.y - range.x);
    base = known < 0.5 ? missing : texture(table, vec2(clamp((v - limit.x) / (limit.y - limit.x), 0.002, 0.998), 0.5)).rgb;
  }
  vec3 m = normalize(gl_FrontFacing ? n : -n);
  float key = max(dot(m, normalize(vec3(-0.35, 0.55, 0.75))), 0.0), head = max(m.z, 0.0);
  float shine = pow(max(dot(m, normalize(vec3(-0.18, 0.28, 0.94))), 0.0), 24.0);
  colour = vec4(base * (0.26 + 0.44 * key + 0.36 * head) + 0.06 * shine, 1.0);
}`;
const LAYERS = ["crests", "hinges", "borders"];
let prog, panels, layers;
const U = {};
try {
  prog = glProgram(gl, VERTEX, FRAGMENT, U);
  layers = makeLayers(gl);
  panels = await Promise.all(config.surfaces.map(load));
} catch (error) { return fail(String(error.message || error)); }
const tables = Object.fromEntries(Object.entries(config.tables).map(([name, rgb]) => [name, texture(rgb)]));

function texture(rgb) {
  const t = gl.createTexture(), data = new Uint8Array(rgb.flat());
  gl.bindTexture(gl.TEXTURE_2D, t);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, rgb.length, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, data);
  for (const [k, v] of [["MIN_FILTER", "LINEAR"], ["MAG_FILTER", "LINEAR"], ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]])
    gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + k], gl[v]);
  return t;
}
function buffer(data, target) { return glBuffer(gl, data, target); }
async function load(meta, index) {
  const raw = await inflate("data-" + index), get = (name) => decode(raw, meta.arrays[name]);
  const faces = get("faces"), final = { g: meta.g, ...unpacked(meta, get) };
  gl.bindVertexArray(null);
  const stages = (meta.stages || []).map((stage, k) => ({ g: stage.g, meta: stage, block: "data-" + index + "-" + k }));
  return { meta, faces, now: final, final, stages: [...stages, final].sort((a, b) => a.g - b.g),
    ids: get("ids"), regions: meta.regions && get("regions"), sphere: meta.sphere && toMm(get("sphere"), meta.sphere),
    box: $("panel-" + index), R: null, picked: -1, hinge: null, net: netOf(meta, get), elements: buffer(faces, gl.ELEMENT_ARRAY_BUFFER) };
}
function unpacked(meta, get) {                 // surfaces and maps of one stage of growth, each decoded when it is first used
  const shape = (name) => {
    const verts = toMm(get(name), meta.surfaces[name]), low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    for (let i = 0; i < verts.length; i++) {
      low[i % 3] = Math.min(low[i % 3], verts[i]); high[i % 3] = Math.max(high[i % 3], verts[i]);
    }
    const centre = low.map((x, k) => (x + high[k]) / 2);
    let radius = 0;
    for (let i = 0; i < verts.length; i += 3)
      radius = Math.max(radius, Math.hypot(verts[i] - centre[0], verts[i + 1] - centre[1], verts[i + 2] - centre[2]));
    return { verts, centre, radius };
  };
  const shapes = onDemand(Object.keys(meta.surfaces), shape);
  const codes = onDemand(Object.keys(meta.maps), (key) => get("map:" + key));
  return { shapes, codes, ranges: meta.maps, arrays: {} };
}
async function grow(g) {                       // show each body at its last stage up to growth g
  state.g = g;
  for (const panel of panels) {
    const stage = panel.stages.filter((s) => s.g <= g + 1e-9).pop() || panel.stages[0];
    if (panel.stages.length < 2) continue;
    if (!stage.shapes) {
      const raw = await inflate(stage.block);
      Object.assign(stage, unpacked(stage.meta, (name) => decode(raw, stage.meta.arrays[name])));
    }
    if (state.g === g) panel.now = stage;      // unless the slider has moved on
    describe(panel);
  }
  redraw();
}
const shapeOf = (panel) => panel.now.shapes[state.surface] || panel.now.shapes.pial;
function normalsOf(panel, shape) { return shape.normals ||= vertexNormals(shape.verts, panel.faces); }
const inView = () => panels.filter((p) => !p.box.hidden);
function bind(panel) {
  const shape = shapeOf(panel);
  if (!shape.vao) {
    normalsOf(panel, shape);
    shape.vao = gl.createVertexArray();
    gl.bindVertexArray(shape.vao);
    for (const [slot, data] of [[0, shape.verts], [1, shape.normals]]) {
      buffer(data);
      gl.enableVertexAttribArray(slot); gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, panel.elements);
  }
  gl.bindVertexArray(shape.vao);
  const { codes: { [state.map]: codes }, arrays } = panel.now;
  if (!codes) return gl.disableVertexAttribArray(2), gl.vertexAttrib1f(2, 65535);
  arrays[state.map] ||= buffer(codes);
  gl.bindBuffer(gl.ARRAY_BUFFER, arrays[state.map]);
  gl.enableVertexAttribArray(2); gl.vertexAttribPointer(2, 1, gl.UNSIGNED_SHORT, false, 0, 0);
}

// ---- drawing ------------------------------------------------------------------------------------------------
function frame(panel) {                        // half height of the view in mm, and the panel's size in px
  const w = panel.box.clientWidth, h = panel.box.clientHeight, size = (p) => (p.final.shapes[state.surface] || p.final.shapes.pial).radius;
  const radius = state.fit ? size(panel) : Math.max(...inView().map(size));      // one scale while a body grows
  return { w, h, perPx: 2 * 1.04 * radius / Math.min(w, h) / state.zoom };
}
function draw() {
  pending = false;
  const dpr = Math.min(window.devicePixelRatio || 1, 2), W = stage.clientWidth, H = stage.clientHeight;
  if (canvas.width !== Math.round(W * dpr) || canvas.height !== Math.round(H * dpr)) {
    canvas.width = Math.round(W * dpr); canvas.height = Math.round(H * dpr);
  }
  gl.disable(gl.SCISSOR_TEST);
  gl.clearColor(1, 1, 1, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.SCISSOR_TEST); gl.enable(gl.DEPTH_TEST);
  gl.useProgram(prog);
  const map = config.maps.find((m) => m.key === state.map);
  const [lo, hi] = map ? limits[map.key] : [0, 1];
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, tables[map && map.signed ? "diverging" : "sequential"]);
  gl.uniform1i(U.table, 0); gl.uniform2f(U.limit, lo, hi);
  gl.uniform3fv(U.missing, config.missing.map((x) => x / 255)); gl.uniform3fv(U.bare, config.bare.map((x) => x / 255));
  let triangles = 0;
  for (const panel of inView()) {
    gl.useProgram(prog);
    const { w, h, perPx } = frame(panel), shape = shapeOf(panel), range = panel.now.ranges[state.map];
    const x = panel.box.offsetLeft, y = H - panel.box.offsetTop - h;
    gl.viewport(x * dpr, y * dpr, w * dpr, h * dpr); gl.scissor(x * dpr, y * dpr, w * dpr, h * dpr);
    const R = panel.R, place = (u) => {
      gl.uniformMatrix3fv(u.R, false, [R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]]);
      gl.uniform3fv(u.centre, shape.centre); gl.uniform2f(u.pan, ...pan(panel, perPx));
      gl.uniform2f(u.scale, 2 / (w * perPx), 2 / (h * perPx)); gl.uniform1f(u.depth, 1.1 * shape.radius);
    };
    place(U);
    gl.uniform2f(U.range, range ? range.low : 0, range ? range.high : 1); gl.uniform1i(U.coloured, map && (range || panel.now === panel.final) ? 1 : 0);
    bind(panel);
    gl.drawElements(gl.TRIANGLES, panel.faces.length, gl.UNSIGNED_INT, 0);
    triangles += panel.faces.length / 3;
    if (panel.now === panel.final) layers.draw(panel, shape, normalsOf(panel, shape), state, place, [w, h]);
    ruler(panel, perPx); mark(panel, perPx); remark(panel);
  }
  gl.bindVertexArray(null);
  root.dataset.triangles = triangles;
  root.dataset.growth = panels.map((p) => p.now.g).join();
  for (const name of LAYERS) root.dataset[name] = state[name];
  root.dataset.map = state.map; root.dataset.surface = state.surface; root.dataset.view = state.view;
}
function remark(panel) {                       // note after the name, if the surface shown is not the one chosen or named
  const said = [];
  if (panel.now !== panel.final) said.push("shown at g = " + panel.now.g);
  if (!panel.now.shapes[state.surface]) said.push("pial: has no " + state.surface + " surface");
  panel.box.querySelector(".remark").textContent = said.length ? " (" + said.join("; ") + ")" : "";
}
let pending = false;
const redraw = () => { if (!pending) { pending = true; requestAnimationFrame(draw); } };
const pan = (panel, perPx) => [state.pan[0] * perPx, state.pan[1] * perPx];
function ruler(panel, perPx) {
  let mm = 1;
  for (const step of [1, 2, 5, 10, 20, 50, 100]) if (step / perPx <= 0.3 * panel.box.clientWidth) mm = step;
  const bar = panel.box.querySelector(".ruler");
  bar.style.width = mm / perPx + "px"; bar.textContent = mm + " mm";
}
function project(panel, i, perPx) {
  const { verts, centre } = shapeOf(panel), R = panel.R, q = [0, 1, 2].map((k) => verts[3 * i + k] - centre[k]);
  const p = [0, 1, 2].map((r) => R[3 * r] * q[0] + R[3 * r + 1] * q[1] + R[3 * r + 2] * q[2]);
  return [panel.box.clientWidth / 2 + p[0] / perPx + state.pan[0], panel.box.clientHeight / 2 - p[1] / perPx - state.pan[1], p[2]];
}
function facing(panel, i) {                    // whether the surface at a vertex faces the viewer
  const n = normalsOf(panel, shapeOf(panel));
  return panel.R[6] * n[3 * i] + panel.R[7] * n[3 * i + 1] + panel.R[8] * n[3 * i + 2] >= 0;
}
function mark(panel, perPx) {
  const dot = panel.box.querySelector(".mark");
  if (panel.picked < 0) { dot.hidden = true; return; }
  const [x, y] = project(panel, panel.picked, perPx);
  dot.hidden = !facing(panel, panel.picked);
  dot.style.left = x + "px"; dot.style.top = y + "px";
}

// ---- picking ------------------------------------------------------------------------------------------------
function pick(panel, px, py) {
  const { perPx } = frame(panel), n = shapeOf(panel).verts.length / 3, at = new Float32Array(3 * n);
  for (let i = 0; i < n; i++) at.set(project(panel, i, perPx), 3 * i);
  let best = -1, front = -1e9;
  for (let t = 0; t < panel.faces.length; t += 3) {
    const [a, b, c] = [3 * panel.faces[t], 3 * panel.faces[t + 1], 3 * panel.faces[t + 2]];
    const side = (i, j) => (at[j] - at[i]) * (py - at[i + 1]) - (at[j + 1] - at[i + 1]) * (px - at[i]);
    const u = side(b, c), v = side(c, a), w = side(a, b);
    if (!((u >= 0 && v >= 0 && w >= 0) || (u <= 0 && v <= 0 && w <= 0)) || u + v + w === 0) continue;
    const z = (u * at[a + 2] + v * at[b + 2] + w * at[c + 2]) / (u + v + w);
    if (z > front) {
      front = z;
      best = [[u, a], [v, b], [w, c]].sort((l, r) => Math.abs(r[0]) - Math.abs(l[0]))[0][1] / 3;
    }
  }
  panel.picked = best;
  panel.hinge = hingesShown(panel) && best >= 0 ? hingeAt(panel, px, py, front, perPx) : null;
  if (panel.hinge) panel.picked = panel.hinge.at;
  describe(panel);
  redraw();
}
function follow(panel) {                       // mark the same point on the other surfaces of the same person
  for (const other of panel.sphere && panel.picked >= 0 ? panels : []) {
    if (other === panel || !other.sphere || other.meta.sphere.person !== panel.meta.sphere.person) continue;
    const p = panel.sphere.subarray(3 * panel.picked, 3 * panel.picked + 3), q = other.sphere;
    let most = -2;
    for (let i = 0; i < q.length; i += 3) {
      const cosine = p[0] * q[i] + p[1] * q[i + 1] + p[2] * q[i + 2];
      if (cosine > most) { most = cosine; other.picked = i / 3; }
    }
    other.hinge = null;
    describe(other);
  }
}
function goTo(panel, i) {                      // turn a vertex to the viewer, mark it in the middle of its panel, and read its values
  if (panel.box.hidden) document.querySelector("input[name=side][value=both]").click();
  reset();
  const n = normalsOf(panel, shapeOf(panel)).subarray(3 * i, 3 * i + 3), flat = Math.hypot(n[0], n[1]);
  const right = flat > 0.1 ? [-n[1] / flat, n[0] / flat, 0] : [1, 0, 0];
  rotate(0, 0);
  panel.R = [...right, n[1] * right[2] - n[2] * right[1], n[2] * right[0] - n[0] * right[2], n[0] * right[1] - n[1] * right[0], ...n];
  state.zoom = 3;
  panel.picked = i;
  const { w, h, perPx } = frame(panel), [x, y] = project(panel, i, perPx);
  state.pan = [w / 2 - x, y - h / 2];
  describe(panel);
  follow(panel);
  stage.scrollIntoView({ block: "nearest" });
  redraw();
}
const hingesShown = (panel) => state.hinges && panel.net && panel.now === panel.final;
function step(panel, by) {                     // to the next visible hinge, from the middle of the panel outwards, then from the start again
  if (!hingesShown(panel)) return;
  const { w, h, perPx } = frame(panel), away = ({ at }) => {
    const [x, y] = project(panel, at, perPx).map((p, k) => Math.abs(p - [w, h, 0][k] / 2));
    return facing(panel, at) && x < w / 2 && y < h / 2 ? Math.hypot(x, y) : Infinity;
  };
  const found = panel.net.hinges.map((hinge) => [away(hinge), hinge]).filter(([d]) => d < Infinity).sort((a, b) => a[0] - b[0]);
  if (!found.length) return;
  const k = found.findIndex(([, hinge]) => hinge === panel.hinge);
  panel.hinge = found.at((k < 0 && by < 0 ? k : k + by) % found.length)[1];
  panel.picked = panel.hinge.at;
  describe(panel);
  redraw();
}
function hingeAt(panel, px, py, front, perPx) {             // the nearest visible hinge within ten pixels
  let found = null, least = 10;
  for (const hinge of panel.net.hinges) {
    const [x, y, z] = project(panel, hinge.at, perPx), away = Math.hypot(x - px, y - py);
    if (away < least && z > front - 4) { least = away; found = hinge; }
  }
  return found;
}
function valueAt(panel, key, i) {
  const code = panel.now.codes[key] ? panel.now.codes[key][i] : 65535, range = panel.now.ranges[key];
  return code === 65535 ? null : range.low + code / 65534 * (range.high - range.low);
}
function describe(panel) {
  const box = panel.box.querySelector(".values"), i = panel.picked;
  box.replaceChildren();
  if (i < 0) return;
  const line = (label, text) => {
    const [pair, dt, dd] = ["div", "dt", "dd"].map((tag) => document.createElement(tag));
    dt.textContent = label; dd.textContent = text; pair.append(dt, dd); box.append(pair);
  };
  if (panel.hinge && hingesShown(panel)) for (const [label, text] of panel.hinge.lines) line(label, text);
  line("Vertex", String(panel.ids[i]));
  if (panel.stages.length > 1) line("Growth", String(panel.now.g));
  if (panel.regions) line("Region", panel.meta.regions[panel.regions[i]]);
  for (const m of config.maps) {
    if (!panel.now.codes[m.key] || !(m.main || m.key === state.map)) continue;
    const v = valueAt(panel, m.key, i);
    line(m.label, v === null ? "not measured" : Number(v.toPrecision(3)) + (m.unit ? " " + m.unit : ""));
  }
}

// ---- controls ------------------------------------------------------------------------------------------------
function look(view) {
  state.view = view;
  for (const panel of panels) panel.R = VIEWS[view](panel.meta.hemi);
  for (const b of document.querySelectorAll("[data-look]")) b.setAttribute("aria-pressed", String(b.dataset.look === view));
  redraw();
}
function rotate(dx, dy) {
  state.view = "free";
  for (const panel of panels) panel.R = turn(turn(panel.R, 1, dx), 0, dy);
  for (const b of document.querySelectorAll("[data-look]")) b.setAttribute("aria-pressed", "false");
  redraw();
}
function move(dx, dy) { state.pan[0] += dx; state.pan[1] -= dy; redraw(); }
function zoom(by) { state.zoom = Math.min(40, Math.max(0.3, state.zoom * by)); redraw(); }
function reset() {
  state.zoom = 1; state.pan = [0, 0];
  for (const panel of panels) { panel.picked = -1; panel.hinge = null; describe(panel); }
  look("lateral");
}
function showMap(key) {
  state.map = key;
  const radios = [...document.querySelectorAll("input[name=map]")], more = document.querySelector("select[name=map]");
  for (const r of radios) r.checked = r.value === key;
  more.value = radios.some((r) => r.checked) ? "" : key || "none";
  more.classList.toggle("chosen", more.value !== "");
  const map = config.maps.find((m) => m.key === key);
  $("bar").hidden = !map;
  if (map) {
    $("bar-title").textContent = map.unit ? map.label + " [" + map.unit + "]" : map.label;
    const rgb = config.tables[map.signed ? "diverging" : "sequential"];
    $("bar-colours").style.background = "linear-gradient(to right," + rgb.filter((_, i) => i % 15 === 0).map((c) => "rgb(" + c + ")").join(",") + ")";
    [$("bar-low").value, $("bar-high").value] = limits[key];
    $("bar-middle").textContent = Number(((limits[key][0] + limits[key][1]) / 2).toPrecision(3));
  }
  panels.forEach(describe);
  redraw();
}
let drag = null;
stage.addEventListener("pointerdown", (e) => {
  if (e.button !== 0 || e.target.closest("dl")) return;
  drag = { x: e.clientX, y: e.clientY, moved: 0, panel: panels.find((p) => p.box.contains(e.target)) };
  stage.setPointerCapture(e.pointerId);
});
stage.addEventListener("pointermove", (e) => {
  if (!drag) return;
  const dx = e.clientX - drag.x, dy = e.clientY - drag.y;
  drag.x = e.clientX; drag.y = e.clientY; drag.moved += Math.abs(dx) + Math.abs(dy);
  if (drag.moved < 4) return;
  if (e.shiftKey) move(dx, dy); else rotate(dx * 0.008, dy * 0.008);
});
stage.addEventListener("pointerup", (e) => {
  if (drag && drag.moved < 4 && drag.panel) {
    const r = drag.panel.box.getBoundingClientRect();
    pick(drag.panel, e.clientX - r.left, e.clientY - r.top);
    follow(drag.panel);
  }
  drag = null;
});
stage.addEventListener("pointercancel", () => { drag = null; });
stage.addEventListener("wheel", (e) => {
  if (document.activeElement !== stage && !e.ctrlKey && !e.metaKey) return;      // the page scrolls
  e.preventDefault();
  zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)));
}, { passive: false });
stage.addEventListener("keydown", (e) => {
  if (e.ctrlKey || e.metaKey || e.altKey) return;               // these are shortcuts of the browser
  const arrow = (x, y) => e.shiftKey ? move(30 * x, 30 * y) : rotate(0.12 * x, 0.12 * y), hinge = (by) => inView().forEach((p) => step(p, by));
  const act = {
    ArrowLeft: () => arrow(-1, 0), ArrowRight: () => arrow(1, 0), ArrowUp: () => arrow(0, -1), ArrowDown: () => arrow(0, 1),
    n: () => hinge(1), p: () => hinge(-1),
    "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15), 0: reset,
    Enter: () => inView().forEach((p) => pick(p, p.box.clientWidth / 2, p.box.clientHeight / 2)),
  }[e.key.length > 1 ? e.key : e.key.toLowerCase()];
  if (act) { e.preventDefault(); act(); }
});
for (const b of document.querySelectorAll("[data-look]")) b.addEventListener("click", () => look(b.dataset.look));
for (const b of document.querySelectorAll("[data-vertex]")) b.addEventListener("click", () => goTo(panels[b.dataset.panel], Number(b.dataset.vertex)));
$("reset").addEventListener("click", reset);
$("zoom-in").addEventListener("click", () => zoom(1.25));
$("zoom-out").addEventListener("click", () => zoom(0.8));
if ($("fit")) $("fit").addEventListener("change", (e) => { state.fit = e.target.checked; redraw(); });
for (const r of document.querySelectorAll("[name=map]")) r.addEventListener("change", () => showMap(r.value === "none" ? "" : r.value));
for (const name of LAYERS) if ($(name)) $(name).addEventListener("change", (e) => { state[name] = e.target.checked; panels.forEach(describe); redraw(); });
if ($("growth")) {
  const steps = [...new Set(panels.flatMap((p) => p.stages.length > 1 ? p.stages.map((s) => s.g) : []))].sort((a, b) => a - b);
  $("growth").max = $("growth").value = steps.length - 1;
  const say = () => {
    $("growth-now").textContent = "g = " + steps[$("growth").value];
    $("growth").setAttribute("aria-valuetext", $("growth-now").textContent);
  };
  $("growth").addEventListener("input", () => { say(); grow(steps[$("growth").value]); });
  say();
}
for (const r of document.querySelectorAll("input[name=side]")) r.addEventListener("change", () => {
  state.side = r.value;
  for (const panel of panels) panel.box.hidden = state.side !== "both" && panel.meta.sided && panel.meta.hemi !== state.side;
  redraw();
});
for (const r of document.querySelectorAll("input[name=surface]")) r.addEventListener("change", () => { state.surface = r.value; redraw(); });
for (const [id, k] of [["bar-low", 0], ["bar-high", 1]]) $(id).addEventListener("change", (e) => {
  const v = e.target.valueAsNumber, next = limits[state.map].slice();        // NaN: the field is empty
  next[k] = v;
  const map = config.maps.find((m) => m.key === state.map);
  if (map.signed) { next[0] = -Math.abs(v); next[1] = Math.abs(v); }
  if (Number.isFinite(v) && next[0] < next[1]) limits[state.map] = next;
  showMap(state.map);
});
$("bar-reset").addEventListener("click", () => {
  limits[state.map] = config.maps.find((m) => m.key === state.map).limits.slice();
  showMap(state.map);
});
window.addEventListener("resize", redraw);
canvas.addEventListener("webglcontextlost", () => fail("the graphics driver dropped the view; reload the page"));
look("lateral");
showMap(state.map);
draw();
root.dataset.viewer = "ready";
})();
