// Draws crests and borders of regions as ribbons, hinges as discs over a surface, of the same size on the screen at every zoom.
"use strict";
const ARMS = { 3: [0.84, 0.37, 0], 4: [0, 0.45, 0.7], 5: [0, 0.62, 0.45] }, CREST = [0.16, 0.16, 0.16], BORDER = [0.1, 0.1, 0.5];
const DOUBT = [0.55, 0.55, 0.55];              // hinges that are not counted
const LIFT = 0.5, TOWARDS = 1.2;               // mm outwards, and towards the viewer: above the surface below them, behind what hides them
const CAMERA = `uniform mat3 R; uniform vec3 centre; uniform vec2 pan, scale, size; uniform float depth, towards, px;
vec4 screen(vec3 at, vec2 moved) { return vec4((at.xy + pan) * scale + 2.0 * moved / size, -(at.z + towards) / depth, 1.0); }`;
const RIBBON = `#version 300 es
layout(location=0) in vec3 a; layout(location=1) in vec3 b; ${CAMERA}
void main() {
  vec3 p = R * (a - centre), q = R * (b - centre);
  vec2 along = (q.xy - p.xy) * scale * size;
  along = length(along) > 1e-5 ? normalize(along) : vec2(1.0, 0.0);
  vec2 side = vec2(-along.y, along.x) * (float(gl_VertexID & 1) * 2.0 - 1.0);
  bool last = gl_VertexID > 1;
  gl_Position = screen(last ? q : p, px * (side + (last ? 0.5 : -0.5) * along));
}`;
const DISC = `#version 300 es
layout(location=0) in vec3 a; layout(location=1) in vec3 b; ${CAMERA} out vec2 corner; out vec3 tint;
void main() {
  corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0; tint = b;
  gl_Position = screen(R * (a - centre), px * corner);
}`;
const PLAIN = `#version 300 es
precision highp float; uniform vec3 tinted; out vec4 colour;
void main() { colour = vec4(tinted, 1.0); }`;
const ROUND = `#version 300 es
precision highp float; in vec2 corner; in vec3 tint; out vec4 colour;
void main() { float r = length(corner); if (r > 1.0) discard; colour = vec4(r > 0.72 ? vec3(1.0) : tint, 1.0); }`;

function glProgram(gl, vs, fs, places) {        // places: receives the locations of the uniforms
  const p = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, vs], [gl.FRAGMENT_SHADER, fs]]) {
    const s = gl.createShader(type);
    gl.shaderSource(s, text); gl.compileShader(s); gl.attachShader(p, s);
  }
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p) || "shader");
  for (let i = 0; i < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(p, i);
    places[name] = gl.getUniformLocation(p, name);
  }
  return p;
}
function glBuffer(gl, data, target = gl.ARRAY_BUFFER) {
  const b = gl.createBuffer();
  gl.bindBuffer(target, b); gl.bufferData(target, data, gl.STATIC_DRAW);
  return b;
}

function netOf(meta, get) {                     // lines of vertex numbers, and hinges; null for a surface without a net
  if (!meta.net) return null;
  const ids = get("crest-ids"), ends = get("crest-ends"), lines = [];
  for (let k = 0; k < ends.length; k++) lines.push(ids.subarray(k ? ends[k - 1] : 0, ends[k]));
  return { lines, hinges: meta.net.hinges };
}

function bordersOf(faces, regions) {            // ends of lines through triangles of several regions: each a mean of vertices
  const ends = [];
  for (let t = 0; t < faces.length; t += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => faces[t + k]), of = [a, b, c].map((i) => regions[i]);
    if (of[0] === of[1] && of[1] === of[2]) continue;
    const sides = [[a, b], [b, c], [c, a]].filter((pair) => regions[pair[0]] !== regions[pair[1]]);
    if (sides.length === 2) ends.push(...sides);
    else for (const side of sides) ends.push(side, [a, b, c]);
  }
  return ends;
}

function makeLayers(gl) {
  const ribbon = {}, disc = {};
  const ribbons = glProgram(gl, RIBBON, PLAIN, ribbon), discs = glProgram(gl, DISC, ROUND, disc);
  const at = (shape, normals, i) => [0, 1, 2].map((k) => shape.verts[3 * i + k] + LIFT * normals[3 * i + k]);

  function placed(net, shape, normals) {        // the net on this shape of the surface; computed once
    const pieces = [];
    for (const line of net.lines) {
      let points = Array.from(line, (i) => at(shape, normals, i));
      for (let turn = 0; turn < 3; turn++)      // smoothing: a line from vertex to vertex zigzags
        points = points.map((p, k) => k && k < points.length - 1 ? p.map((x, c) => (points[k - 1][c] + 2 * x + points[k + 1][c]) / 4) : p);
      for (let k = 1; k < points.length; k++) pieces.push(...points[k - 1], ...points[k]);
    }
    const dots = net.hinges.flatMap((h) => [...at(shape, normals, h.at), ...(h.doubtful ? DOUBT : ARMS[Math.min(h.degree, 5)])]);
    return { crests: instances(pieces), hinges: instances(dots) };
  }
  function outlined(ends, shape, normals) {     // the borders on this shape of the surface; computed once
    const mean = (ids) => ids.map((i) => at(shape, normals, i)).reduce((p, q) => p.map((x, k) => x + q[k])).map((x) => x / ids.length);
    return instances(ends.flatMap(mean));
  }
  function instances(numbers) {
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    glBuffer(gl, new Float32Array(numbers));
    for (const slot of [0, 1]) {
      gl.enableVertexAttribArray(slot); gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 24, 12 * slot);
      gl.vertexAttribDivisor(slot, 1);
    }
    gl.bindVertexArray(null);
    return { vao, count: numbers.length / 6 };
  }
  function show({ vao, count }, program, places, place, size, px, towards, tint) {
    gl.useProgram(program);
    place(places);
    gl.uniform2f(places.size, ...size); gl.uniform1f(places.px, px); gl.uniform1f(places.towards, towards);
    if (places.tinted) gl.uniform3fv(places.tinted, tint);
    gl.bindVertexArray(vao);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
  }
  return {
    draw(panel, shape, normals, shown, place, size) {
      if (shown.borders && panel.regions) {
        shape.borders ||= outlined(panel.borders ||= bordersOf(panel.faces, panel.regions), shape, normals);
        show(shape.borders, ribbons, ribbon, place, size, 1, TOWARDS, BORDER);
      }
      if (!panel.net || !shown.crests && !shown.hinges) return;
      const layer = shape.layer ||= placed(panel.net, shape, normals);
      if (shown.crests) show(layer.crests, ribbons, ribbon, place, size, 1.3, TOWARDS, CREST);
      if (shown.hinges) show(layer.hinges, discs, disc, place, size, 5.5, 2 * TOWARDS);
    },
  };
}
