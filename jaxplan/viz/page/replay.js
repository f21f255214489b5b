"use strict";
// The replay: what there is to see at an instant, its panel and its controls. `data` is what jaxplan/viz/html.py wrote.

const $ = (id) => document.getElementById(id);
const KINDS = { float32: Float32Array, uint8: Uint8Array, uint32: Uint32Array };

function decoded({ dtype, shape, base64 }) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return { flat: new KINDS[dtype](bytes.buffer), shape };
}

// Rows first .. first + count of an array of points, as [[x, y, z], ..].
function rows(array, first, count, width = 3) {
  const out = [];
  for (let i = first; i < first + count; i++) out.push(Array.from(array.flat.subarray(i * width, (i + 1) * width)));
  return out;
}

// The last place in ascending values that is not after `value`; -1 before the first.
function newest(values, value) {
  let low = 0, high = values.length;
  while (low < high) { const middle = (low + high) >> 1; if (values[middle] <= value + 1e-6) low = middle + 1; else high = middle; }
  return low - 1;
}

class Replay {
  constructor(data) {
    this.data = data;
    this.arrays = Object.fromEntries(Object.entries(data.arrays).map(([name, array]) => [name, decoded(array)]));
    const a = this.arrays;
    this.times = a.times.flat; this.first = this.times[0]; this.last = this.times[this.times.length - 1];
    this.position = rows(a.position, 0, this.times.length); this.target = rows(a.target, 0, this.times.length);
    this.quat = rows(a.quat, 0, this.times.length, 4);
    this.knowsTarget = Number.isFinite(this.target[0][0]);
    this.starts = data.plans.map((plan) => plan.start); this.cycleTimes = data.cycles.map((cycle) => cycle.time);
    this.apart = this.position.map((p, i) => Math.hypot(...minus(p, this.target[i])));
    this.speed = this.position.map((p, i) => {
      const [j, k] = [Math.max(i - 1, 0), Math.min(i + 1, this.times.length - 1)];
      return k > j ? Math.hypot(...minus(this.position[k], this.position[j])) / (this.times[k] - this.times[j]) : 0;
    });
    let committed = -1;
    this.committed = data.cycles.map((cycle) => (committed = Math.max(committed, cycle.plan)));
  }

  between(list, time) {
    const i = Math.max(newest(this.times, time), 0), j = Math.min(i + 1, this.times.length - 1);
    const share = j > i ? Math.min(Math.max((time - this.times[i]) / (this.times[j] - this.times[i]), 0), 1) : 0;
    if (typeof list[i] === "number") return list[i] + share * (list[j] - list[i]);
    const sign = list[i].length === 4 && list[i].reduce((sum, x, k) => sum + x * list[j][k], 0) < 0 ? -1 : 1;
    return list[i].map((x, k) => x + share * (sign * list[j][k] - x));
  }

  until(list, time) { return [...list.slice(0, newest(this.times, time) + 1), this.between(list, time)]; }

  // The newest committed plan, and from when to when of it is flown.
  plan(time, cycle) {
    const index = Math.max(cycle < 0 ? -1 : this.committed[cycle], newest(this.starts, time));
    if (index < 0) return null;
    const plan = this.data.plans[index], points = rows(this.arrays.plan_points, 100 * index, 100), length = plan.end - plan.start;
    const next = index + 1 < this.starts.length ? this.starts[index + 1] : Infinity;
    const place = (t) => {
      const x = Math.min(Math.max((t - plan.start) / length, 0), 1) * 99, i = Math.min(Math.floor(x), 98);
      return points[i].map((v, k) => v + (x - i) * (points[i + 1][k] - v));
    };
    const part = (from, to) => {
      const [a, b] = [Math.max(from, plan.start), Math.min(to, plan.end)];
      if (b <= a) return [];
      return [place(a), ...points.filter((_, i) => plan.start + length * i / 99 > a && plan.start + length * i / 99 < b), place(b)];
    };
    const meets = plan.meets && plan.arrival >= plan.start && plan.arrival <= plan.end + 1e-6 ? place(plan.arrival) : null;
    return { ...plan, index, flown: part(-Infinity, time), ahead: part(time, next), rest: part(Math.max(time, next), Infinity), stop: points[99], meets };
  }
}

const ARMS = [[0.7, 0.7], [0.7, -0.7], [-0.7, 0.7], [-0.7, -0.7]];

// A quadrotor of arm length 1: a body, its arms and rotors; x is forward.
function quadrotor() {
  const [ball, faces] = sphere(8, 16), vertices = [], out = [];
  const blob = (x, y, z, sx, sy, sz, turn) => {
    const base = vertices.length / 3, [c, s] = [Math.cos(turn), Math.sin(turn)];
    for (let i = 0; i < ball.length; i += 3) {
      const [u, v, w] = [ball[i] * sx, ball[i + 1] * sy, ball[i + 2] * sz];
      vertices.push(x + c * u - s * v, y + s * u + c * v, z + w);
    }
    for (const f of faces) out.push(base + f);
  };
  blob(0.06, 0, 0, 0.42, 0.24, 0.16, 0); blob(0.42, 0, 0.05, 0.12, 0.12, 0.1, 0);
  for (const [x, y] of ARMS) { blob(0.5 * x, 0.5 * y, 0, 0.52, 0.07, 0.06, Math.atan2(y, x)); blob(x, y, 0.12, 0.52, 0.52, 0.035, 0); }
  return [vertices, out];
}

function pose(place, [w, x, y, z], scale) {
  const n = 2 / (w * w + x * x + y * y + z * z), s = scale;
  return [s * (1 - n * (y * y + z * z)), s * n * (x * y + w * z), s * n * (x * z - w * y), 0,
    s * n * (x * y - w * z), s * (1 - n * (x * x + z * z)), s * n * (y * z + w * x), 0,
    s * n * (x * z + w * y), s * n * (y * z - w * x), s * (1 - n * (x * x + y * y)), 0, ...place, 1];
}

class Stage {
  constructor(replay, canvas) {
    this.replay = replay;
    const { data, arrays } = replay, scene = this.scene = new Scene(canvas, data.bounds);
    const [low, high] = data.bounds;
    const lines = [], step = Math.max(1, Math.round(Math.max(high[0] - low[0], high[1] - low[1]) / 30));
    for (let x = Math.ceil(low[0]); x <= high[0]; x += step) lines.push([[x, low[1], low[2]], [x, high[1], low[2]]]);
    for (let y = Math.ceil(low[1]); y <= high[1]; y += step) lines.push([[low[0], y, low[2]], [high[0], y, low[2]]]);
    const floor = low[2] - 0.004;
    scene.mesh("floor", [low[0], low[1], floor, high[0], low[1], floor, high[0], high[1], floor, low[0], high[1], floor], [0, 1, 2, 0, 2, 3], { colour: rgba("#ffffff"), layer: -2 });
    scene.lines("grid", lines, [rgba("#dfe4ea")], { width: 1, layer: -1 });
    const corner = (i) => [0, 1, 2].map((k) => data.bounds[(i >> k) & 1][k]);
    const edges = [];
    for (let i = 0; i < 8; i++) for (let k = 0; k < 3; k++) if (!((i >> k) & 1)) edges.push([corner(i), corner(i | (1 << k))]);
    scene.lines("room", edges, [rgba("#9aa4b2")], { width: 1.2 });
    if (arrays.world_faces.flat.length) scene.mesh("world", arrays.world_vertices.flat, arrays.world_faces.flat, { colour: rgba("#bcc5d1") });
    const count = arrays.world_edges.shape[0];
    scene.lines("edges", Array.from({ length: count }, (_, i) => rows(arrays.world_edges, 2 * i, 2)), [rgba("#6d7887", 0.75)], { width: 1.1, lift: 0.00005 });
    this.quadrotor = quadrotor(); this.ball = sphere();
    this.cycle = null;
  }

  curve(name, points, colour, settings) { this.scene.lines(name, points.length > 1 ? [points] : [], [rgba(colour)], settings); }

  at(time, layers) {
    const { replay, scene } = this, { data } = replay, floor = data.bounds[0][2] + 0.01;
    const me = replay.between(replay.position, time), it = replay.between(replay.target, time), cycle = newest(replay.cycleTimes, time);
    const flown = replay.until(replay.position, time), seen = replay.knowsTarget ? replay.until(replay.target, time) : [];
    this.curve("flown", flown, "#0072B2", { width: 4, xray: 0.3, lift: 0.0012 });
    this.curve("target trail", seen, "#D55E00", { width: 3, dash: 0.16, xray: 0.3, lift: 0.0012 });
    const low = (path) => path.map(([x, y]) => [x, y, floor]);
    scene.lines("shadows", [low(flown), low(seen), [me, [me[0], me[1], floor]], ...(seen.length ? [[it, [it[0], it[1], floor]]] : [])].filter((c) => c.length > 1), [rgba("#5b6472", 0.35)], { width: 1.4, layer: 0 });
    const plan = replay.plan(time, cycle);
    this.curve("plan flown", plan ? plan.flown : [], "#56B4E9", { width: 7, alpha: 0.45, lift: 0.0004 });
    this.curve("plan ahead", plan ? plan.ahead : [], "#004D38", { width: 3.6, xray: 0.35, lift: 0.0016 });
    this.curve("plan rest", plan ? plan.rest : [], "#004D38", { width: 2, dash: 0.14, xray: 0.35, lift: 0.0016 });
    scene.points("stop", plan ? [plan.stop] : [], [rgba("#004D38")], { width: 13, ring: 0.3, layer: 4, xray: 0.4 });
    scene.points("meeting", plan && plan.meets ? [plan.meets] : [], [rgba("#F0C000")], { width: 17, ring: 0.26, layer: 4, xray: 0.5 });
    if (cycle !== this.cycle) this.candidates(cycle);
    this.cycle = cycle;
    const camera = scene.camera;
    if (this.follows) camera.centre = camera.centre.map((x, i) => x + (me[i] - x) * 0.18);
    for (const [name, layer] of Object.entries(layers)) for (const node of layer.nodes) if (scene.nodes.has(node)) scene.nodes.get(node).visible = layer.on;
    const { padding_vertices: vertices, padding_faces: faces } = this.replay.arrays;
    if (layers.padding.on && faces.flat.length && !scene.nodes.has("padding")) {  // large, and hardly ever looked at
      scene.mesh("padding", vertices.flat, faces.flat, { colour: rgba("#E9A53B", 0.3), rim: 0.8, layer: 6 }, 0.9);
    }
    for (const name of ["world", "edges", "padding"]) if (scene.nodes.has(name)) scene.nodes.get(name).ceiling = layers.cut.on ? data.ceiling ?? 1e9 : 1e9;
    scene.draw();  // tells where pixels are
    this.vehicle("defender", me, replay.between(replay.quat, time), data.radius, "#0072B2");
    if (replay.knowsTarget) {
      this.vehicle("target", it, [1, 0, 0, 0], data.radius, "#D55E00");
      const [x, y, z] = it, r = data.capture;
      scene.mesh_once("capture", this.ball, { models: [[r, 0, 0, 0, 0, r, 0, 0, 0, 0, r, 0, x, y, z, 1]], colour: rgba("#D55E00", 0.3), rim: 1, layer: 5 });
    }
    this.shown = scene.draw();
    return { me, it, cycle, plan, time };
  }

  vehicle(name, place, quat, radius, colour) {
    const there = this.scene.screen(place), scale = Math.max(radius, there ? 15 * there.metre : radius);
    this.scene.mesh_once(name, this.quadrotor, { models: [pose(place, quat, scale)], colour: rgba(colour), layer: 1, xray: 0.3 });
  }

  // What belongs to a cycle: candidates, their trajectories, the prediction.
  candidates(index) {
    const { data, arrays } = this.replay, scene = this.scene, cycle = data.cycles[index], palette = data.groups.map((g) => g.colour);
    const span = cycle || { goals: [0, 0], curves: [0, 0], ellipsoids: [0, 0], mean: [0, 0] };
    const order = (groups, first, count) => Array.from({ length: count }, (_, i) => first + i).sort((a, b) => groups[b] - groups[a]);
    const goals = order(arrays.goal_groups.flat, ...span.goals).filter((i) => Number.isFinite(arrays.goals.flat[3 * i]));
    scene.points("candidates", goals.map((i) => rows(arrays.goals, i, 1)[0]), goals.map((i) => rgba(palette[arrays.goal_groups.flat[i]])), { width: 4.5 });
    const curves = order(arrays.curve_groups.flat, ...span.curves), length = arrays.curves.shape[1];
    scene.lines("trajectories", curves.map((i) => rows(arrays.curves, length * i, length)), curves.map((i) => rgba(palette[arrays.curve_groups.flat[i]], 0.45)), { width: 1.2 });
    const models = [], colours = [], [first, count] = span.ellipsoids;
    for (let i = first; i < first + count; i++) {
      const m = arrays.ellipsoids.flat.subarray(12 * i, 12 * i + 12);
      models.push([m[0], m[1], m[2], 0, m[3], m[4], m[5], 0, m[6], m[7], m[8], 0, m[9], m[10], m[11], 1]);
      colours.push(rgba("#7B55D0", 0.1 + 0.3 * Math.sqrt(arrays.ellipsoid_weights.flat[i])));
    }
    scene.mesh_once("prediction", this.ball, { models, colours, rim: 1, layer: 5 });
    const mean = rows(arrays.means, ...span.mean);
    this.curve("prediction mean", mean, "#7B55D0", { width: 2, xray: 0.3 });
    scene.points("prediction steps", mean, [rgba("#7B55D0")], { width: 5, ring: 0.3 });
  }
}

// A mesh that keeps its shape and only moves.
Scene.prototype.mesh_once = function (name, [vertices, faces], settings) {
  if (this.nodes.has(name)) this.node(name, "mesh", settings); else this.mesh(name, vertices, faces, settings, 0.9);
};
