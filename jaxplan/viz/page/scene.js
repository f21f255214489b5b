"use strict";
// A small scene on WebGL 2: meshes, lines of a width in pixels, points and ellipsoids, seen by a camera that orbits.
// World frame as everywhere: metres, z up. Matrices are column-major arrays of 16.

const MESH_VERTEX = `#version 300 es
in vec3 place; in vec3 normal;
uniform mat4 model, seen;
out vec3 n, p;
void main() { vec4 w = model * vec4(place, 1.0); p = w.xyz; n = inverse(transpose(mat3(model))) * normal; gl_Position = seen * w; }`;

const MESH_FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, p;
uniform vec3 eye; uniform vec4 colour; uniform float rim, ceiling;
out vec4 pixel;
void main() {
  if (p.z > ceiling) discard;
  vec3 u = normalize(gl_FrontFacing ? n : -n), v = normalize(eye - p);
  float sky = 0.5 + 0.5 * u.z, sun = max(dot(u, normalize(vec3(0.35, -0.5, 0.8))), 0.0);
  vec3 lit = colour.rgb * (0.58 + 0.26 * sky + 0.24 * sun);
  float edge = pow(1.0 - abs(dot(u, v)), 2.0);
  pixel = vec4(lit, colour.a * mix(1.0, 0.25 + 1.1 * edge, rim));
}`;

const LINE_VERTEX = `#version 300 es
in vec4 a, b; in vec4 from, to;
uniform mat4 seen; uniform vec2 size; uniform float width, lift, cap;
out vec4 tint; out float along, height;
void main() {
  int end = gl_VertexID >> 1; float side = float(gl_VertexID & 1) * 2.0 - 1.0;
  vec4 A = seen * vec4(a.xyz, 1.0), B = seen * vec4(b.xyz, 1.0);
  const float near = 0.02;
  if (b.w < a.w || (A.w < near && B.w < near)) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (A.w < near) A = mix(A, B, (near - A.w) / (B.w - A.w));
  if (B.w < near) B = mix(B, A, (near - B.w) / (A.w - B.w));
  vec2 way = (B.xy / B.w - A.xy / A.w) * size;
  float length2 = dot(way, way);
  way = length2 > 1e-8 ? way * inversesqrt(length2) : vec2(1.0, 0.0);
  vec4 place = end == 0 ? A : B;
  vec2 off = (vec2(-way.y, way.x) * side + way * (end == 0 ? -cap : cap)) * 0.5 * width / size;
  place.xy += off * place.w; place.z -= lift * place.w;
  gl_Position = place; tint = end == 0 ? from : to; along = end == 0 ? a.w : b.w; height = end == 0 ? a.z : b.z;
}`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec4 tint; in float along, height; uniform float dash, alpha, ceiling; out vec4 pixel;
void main() { if (height > ceiling || dash > 0.0 && fract(along / dash) > 0.55) discard; pixel = vec4(tint.rgb, tint.a * alpha); }`;

const POINT_VERTEX = `#version 300 es
in vec3 place; in vec4 tinted; uniform mat4 seen; uniform float width; out vec4 tint;
void main() { gl_Position = seen * vec4(place, 1.0); gl_Position.z -= 0.0006 * gl_Position.w; gl_PointSize = width; tint = tinted; }`;

const POINT_FRAGMENT = `#version 300 es
precision highp float;
in vec4 tint; uniform float alpha, ring; out vec4 pixel;
void main() {
  float r = 2.0 * length(gl_PointCoord - 0.5);
  if (r > 1.0) discard;
  pixel = vec4(mix(tint.rgb, vec3(1.0), step(1.0 - ring, r)), tint.a * alpha);
}`;

const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

function product(a, b) {
  const c = new Float32Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++)
    for (let k = 0; k < 4; k++) c[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return c;
}

function rgba(hex, alpha = 1) {
  const v = parseInt(hex.slice(1), 16);
  return [((v >> 16) & 255) / 255, ((v >> 8) & 255) / 255, (v & 255) / 255, alpha];
}

// Where a matrix takes a place, before the division: x, y and w.
function clip(m, [x, y, z]) { return [0, 1, 3].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]); }

class Camera {
  constructor(bounds) {
    this.bounds = bounds;
    this.centre = bounds[0].map((low, i) => (low + bounds[1][i]) / 2);
    this.reach = Math.hypot(...minus(bounds[1], bounds[0]));
    this.azimuth = -2.2; this.elevation = 0.75; this.field = 0.6; this.aspect = 1.6;
    this.fit();
  }

  // As near as the whole room can be seen from.
  fit() {
    this.distance = 0.3 * this.reach;
    const corners = Array.from({ length: 8 }, (_, i) => [0, 1, 2].map((k) => this.bounds[(i >> k) & 1][k]));
    const inside = () => { const m = this.seen(this.aspect); return corners.every((c) => { const [x, y, w] = clip(m, c); return w > 0 && Math.max(Math.abs(x), Math.abs(y)) < 0.95 * w; }); };
    while (!inside() && this.distance < 10 * this.reach) this.distance *= 1.02;
  }

  get back() {
    const c = Math.cos(this.elevation);
    return [c * Math.cos(this.azimuth), c * Math.sin(this.azimuth), Math.sin(this.elevation)];
  }

  get up() {
    const s = Math.sin(this.elevation);
    return [-s * Math.cos(this.azimuth), -s * Math.sin(this.azimuth), Math.cos(this.elevation)];
  }

  get eye() { return plus(this.centre, this.back, this.distance); }

  seen(aspect) {
    const z = this.back, y = this.up, x = cross(y, z), eye = this.eye;
    const view = [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
    const near = 0.02 * this.distance, far = this.distance + 3 * this.reach, f = 1 / Math.tan(this.field / 2);
    return product([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0], view);
  }

  pan(dx, dy, height) {
    const scale = 2 * this.distance * Math.tan(this.field / 2) / height, x = cross(this.up, this.back);
    this.centre = plus(plus(this.centre, x, -dx * scale), this.up, dy * scale);
  }
}

class Scene {
  constructor(canvas, bounds) {
    this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.camera = new Camera(bounds);
    this.nodes = new Map();
    this.programs = {
      mesh: this.program(MESH_VERTEX, MESH_FRAGMENT), line: this.program(LINE_VERTEX, LINE_FRAGMENT),
      points: this.program(POINT_VERTEX, POINT_FRAGMENT),
    };
    gl.enable(gl.DEPTH_TEST); gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(1, 1);  // faces stay behind the lines on them
    gl.enable(gl.BLEND); gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  program(vertex, fragment) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
      gl.attachShader(p, s);
    }
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    const uniforms = {}, count = gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) { const { name } = gl.getActiveUniform(p, i); uniforms[name] = gl.getUniformLocation(p, name); }
    return { p, uniforms, at: (name) => gl.getAttribLocation(p, name) };
  }

  node(name, kind, settings) {
    const known = this.nodes.get(name);
    if (known) { Object.assign(known, settings); return known; }
    const made = { name, kind, visible: true, count: 0, vao: this.gl.createVertexArray(), buffers: {}, ...settings };
    this.nodes.set(name, made);
    return made;
  }

  fill(node, attribute, values, size, { offset = 0, stride = 0, divisor = 0, kind = this.gl.FLOAT, key = attribute } = {}) {
    const gl = this.gl, place = this.programs[node.kind].at(attribute);
    gl.bindVertexArray(node.vao);
    if (!node.buffers[key]) node.buffers[key] = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, node.buffers[key]);
    if (values) gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, kind, kind !== gl.FLOAT, stride, offset);
    gl.vertexAttribDivisor(place, divisor);
  }

  // Triangles; corners are smooth where faces turn by less than `crease` [rad].
  mesh(name, vertices, faces, settings, crease = 0.5) {
    const node = this.node(name, "mesh", { models: [IDENTITY], rim: 0, layer: 0, ...settings });
    const [place, normal] = corners(vertices, faces, Math.cos(crease));
    this.fill(node, "place", place, 3); this.fill(node, "normal", normal, 3);
    node.count = place.length / 3;
    return node;
  }

  // Lines through points [[x, y, z], ..]; several of them at once; `colours` one for each line.
  lines(name, curves, colours, settings) {
    const node = this.node(name, "line", { width: 1.5, dash: 0, alpha: 1, xray: 0, lift: 0.0008, layer: 1, ...settings });
    const total = curves.reduce((sum, curve) => sum + curve.length, 0);
    const points = new Float32Array(4 * total), tints = new Uint8Array(4 * total);
    let row = 0;
    curves.forEach((curve, index) => {
      const tint = colours[index % colours.length].map((x) => 255 * x);
      let along = index === 0 ? 0 : -1e-3 * index;  // falls where one line ends, so that nothing joins it to the next
      curve.forEach((point, i) => {
        if (i) along += Math.max(Math.hypot(...minus(point, curve[i - 1])), 1e-6);
        points.set([...point, along], 4 * row); tints.set(tint, 4 * row); row++;
      });
    });
    const gl = this.gl, half = { stride: 16, divisor: 1, key: "points" }, byte = { stride: 4, divisor: 1, kind: gl.UNSIGNED_BYTE, key: "tints" };
    this.fill(node, "a", points, 4, half); this.fill(node, "b", null, 4, { ...half, offset: 16 });
    this.fill(node, "from", tints, 4, byte); this.fill(node, "to", null, 4, { ...byte, offset: 4 });
    node.count = Math.max(total - 1, 0);
    return node;
  }

  points(name, places, colours, settings) {
    const node = this.node(name, "points", { width: 6, ring: 0, alpha: 1, xray: 0, layer: 2, ...settings });
    const tints = new Uint8Array(4 * places.length);
    places.forEach((_, i) => tints.set(colours[i % colours.length].map((x) => 255 * x), 4 * i));
    this.fill(node, "place", new Float32Array(places.flat()), 3);
    this.fill(node, "tinted", tints, 4, { kind: this.gl.UNSIGNED_BYTE });
    node.count = places.length;
    return node;
  }

  draw() {
    const gl = this.gl, canvas = this.canvas, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.max(1, Math.round(x * ratio)));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h);
    gl.depthMask(true); gl.clearColor(...BACKGROUND, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.camera.aspect = w / h;
    const seen = this.camera.seen(w / h), shown = [...this.nodes.values()].filter((n) => n.visible && n.count);
    this.view = { seen, ratio, w, h };
    for (const node of shown.sort((a, b) => a.layer - b.layer)) {
      if (node.xray) { gl.depthFunc(gl.GREATER); this.one(node, node.xray); gl.depthFunc(gl.LEQUAL); }
      this.one(node, 1);
    }
    gl.depthMask(true);
    return shown;
  }

  one(node, share) {
    const gl = this.gl, { seen, ratio, w, h } = this.view, { p, uniforms } = this.programs[node.kind];
    gl.useProgram(p); gl.uniform1f(uniforms.ceiling, node.ceiling ?? 1e9); gl.bindVertexArray(node.vao); gl.uniformMatrix4fv(uniforms.seen, false, seen);
    gl.depthMask(share === 1 && !(node.colour && node.colour[3] < 1) && !node.rim && node.kind !== "line");
    if (node.kind === "mesh") {
      gl.uniform3fv(uniforms.eye, this.camera.eye); gl.uniform1f(uniforms.rim, node.rim);
      node.models.forEach((model, i) => {
        const [r, g, b, a] = node.colours ? node.colours[i] : node.colour;
        gl.uniform4f(uniforms.colour, r, g, b, a * share); gl.uniformMatrix4fv(uniforms.model, false, model);
        gl.drawArrays(gl.TRIANGLES, 0, node.count);
      });
      return;
    }
    gl.uniform1f(uniforms.width, node.width * ratio); gl.uniform1f(uniforms.alpha, node.alpha * share);
    if (node.kind === "line") {
      gl.uniform2f(uniforms.size, w / 2, h / 2); gl.uniform1f(uniforms.dash, node.dash); gl.uniform1f(uniforms.lift, node.lift);
      gl.uniform1f(uniforms.cap, node.alpha * share < 1 ? 0 : 0.6);  // what shows through must not overlap itself
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, node.count);
    } else { gl.uniform1f(uniforms.ring, node.ring); gl.drawArrays(gl.POINTS, 0, node.count); }
  }

  // Where a place is on the canvas in CSS pixels, and metres per pixel there; null behind the camera.
  screen(place) {
    const v = clip(this.view.seen, place);
    if (v[2] <= 0) return null;
    const { clientWidth: w, clientHeight: h } = this.canvas;
    return { x: (v[0] / v[2] + 1) * w / 2, y: (1 - v[1] / v[2]) * h / 2, metre: 2 * v[2] * Math.tan(this.camera.field / 2) / h };
  }

  // The share of pixels that differ from the background, of a picture drawn just now.
  covered() {
    const gl = this.gl, { w, h } = this.view, data = new Uint8Array(4 * w * h), plain = BACKGROUND.map((x) => Math.round(255 * x));
    gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, data);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) if (plain.some((x, k) => Math.abs(data[i + k] - x) > 3)) count++;
    return count / (w * h);
  }
}

const BACKGROUND = [0.957, 0.965, 0.976];

// Places and normals of all triangles' corners: a normal is that of all faces around it which turn by little. In flat
// arrays throughout, as a world has 10^5 triangles.
function corners(vertices, faces, least) {
  const count = faces.length / 3, normals = new Float32Array(3 * count), units = new Float32Array(3 * count);
  const starts = new Uint32Array(vertices.length / 3 + 1), around = new Uint32Array(3 * count);
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [3 * faces[3 * f], 3 * faces[3 * f + 1], 3 * faces[3 * f + 2]];
    const ux = vertices[b] - vertices[a], uy = vertices[b + 1] - vertices[a + 1], uz = vertices[b + 2] - vertices[a + 2];
    const vx = vertices[c] - vertices[a], vy = vertices[c + 1] - vertices[a + 1], vz = vertices[c + 2] - vertices[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx, n = Math.sqrt(x * x + y * y + z * z) || 1;
    normals[3 * f] = x; normals[3 * f + 1] = y; normals[3 * f + 2] = z;
    units[3 * f] = x / n; units[3 * f + 1] = y / n; units[3 * f + 2] = z / n;
  }
  for (let i = 0; i < 3 * count; i++) starts[faces[i] + 1]++;
  for (let v = 1; v < starts.length; v++) starts[v] += starts[v - 1];
  const filled = starts.slice();
  for (let i = 0; i < 3 * count; i++) around[filled[faces[i]]++] = (i / 3) | 0;
  const place = new Float32Array(9 * count), normal = new Float32Array(9 * count);
  for (let i = 0; i < 3 * count; i++) {
    const v = faces[i], f = 3 * ((i / 3) | 0);
    let [x, y, z] = [0, 0, 0];
    for (let k = starts[v]; k < starts[v + 1]; k++) {
      const g = 3 * around[k];
      if (units[f] * units[g] + units[f + 1] * units[g + 1] + units[f + 2] * units[g + 2] < least) continue;
      x += normals[g]; y += normals[g + 1]; z += normals[g + 2];
    }
    const n = Math.sqrt(x * x + y * y + z * z) || 1;
    for (let k = 0; k < 3; k++) place[3 * i + k] = vertices[3 * v + k];
    normal[3 * i] = x / n; normal[3 * i + 1] = y / n; normal[3 * i + 2] = z / n;
  }
  return [place, normal];
}

function sphere(rings = 12, around = 24) {
  const vertices = [], faces = [];
  for (let i = 0; i <= rings; i++) for (let j = 0; j < around; j++) {
    const t = Math.PI * i / rings, s = 2 * Math.PI * j / around;
    vertices.push(Math.sin(t) * Math.cos(s), Math.sin(t) * Math.sin(s), Math.cos(t));
    if (i < rings) {
      const a = i * around + j, b = i * around + (j + 1) % around, c = a + around, d = b + around;
      if (i) faces.push(a, c, b);
      if (i < rings - 1) faces.push(b, c, d);
    }
  }
  return [vertices, faces];
}
