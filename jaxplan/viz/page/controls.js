"use strict";
// Panel, timeline and controls around the stage.

const LAYERS = {
  defender: { label: "defender, flown", nodes: ["flown", "defender"], mark: ["line", "#0072B2"], on: true },
  target: { label: "target; within the sphere it counts as met", nodes: ["target trail", "target", "capture"], mark: ["dash", "#D55E00"], on: true },
  plan: { label: "plan, to be flown", nodes: ["plan flown", "plan ahead"], mark: ["line", "#004D38"], on: true },
  rest: { label: "replaced later", nodes: ["plan rest"], mark: ["dash", "#004D38"], on: true },
  meeting: { label: "meeting point", nodes: ["meeting"], mark: ["dot", "#F0C000"], on: true },
  stop: { label: "stop point", nodes: ["stop"], mark: ["dot", "#004D38"], on: true },
  candidates: { label: "candidates, coloured by reason", nodes: ["candidates"], mark: ["dot", "#009E73"], on: true },
  trajectories: { label: "their trajectories", nodes: ["trajectories"], mark: ["line", "#009E73"], on: true },
  prediction: { label: "prediction, 2σ", nodes: ["prediction", "prediction mean", "prediction steps"], mark: ["area", "#B9A3E3"], on: true },
  world: { label: "obstacles", nodes: ["world", "edges"], mark: ["area", "#bcc5d1"], on: true },
  cut: { label: "cut open above", nodes: [], mark: ["area", "#ffffff; border: 1px dashed #6d7887"], on: true },
  padding: { label: "padding", nodes: ["padding"], mark: ["area", "#F3D3A0"], on: false },
};
const STAGES = ["#264653", "#2A7F9E", "#58A6C4", "#9CC9D9", "#6C757D", "#ADB5BD", "#495867", "#7B9E89", "#B8C4BB", "#D0D4D9"];
const number = (x, digits, unit) => (Number.isFinite(x) ? `${x.toFixed(digits)}${unit ? " " + unit : ""}` : "–");

function element(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

class Player {
  constructor(data) {
    this.replay = new Replay(data); this.stage = new Stage(this.replay, $("scene"));
    this.time = this.replay.first; this.playing = false; this.drawn = null; this.listed = null;
    $("title").textContent = data.title; $("subtitle").textContent = data.subtitle;
    $("scrub").min = this.replay.first; $("scrub").max = this.replay.last;
    this.layers(); this.buttons(); this.camera();
    let before = null;
    const tick = (now) => {
      if (this.playing && before !== null) this.seek(this.time + Number($("rate").value) * Math.min((now - before) / 1000, 0.1), true);
      before = now;
      if (this.playing || this.dirty || this.stage.follows) this.draw();
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    new ResizeObserver(() => (this.dirty = true)).observe(document.body);
    this.draw(); this.stage.scene.camera.fit();
    const committed = data.cycles.find((cycle) => cycle.plan >= 0);
    this.seek(committed ? committed.time : this.replay.first); this.draw();
  }

  seek(time, running = false) {
    this.time = Math.min(Math.max(time, this.replay.first), this.replay.last);
    if (running && this.time >= this.replay.last) this.play(false);
    this.dirty = true;
  }

  play(on) {
    if (on && this.time >= this.replay.last) this.time = this.replay.first;
    this.playing = on; this.dirty = true;
    $("play").querySelector("path").setAttribute("d", on ? "M3 2h4v12H3zM9 2h4v12H9z" : "M3 1.5v13L14 8z");
    $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  }

  // To the cycle before or after; where there are none, by 0.1 s.
  step(by) {
    const times = this.replay.cycleTimes, at = newest(times, this.time);
    this.play(false);
    if (!times.length) return this.seek(this.time + 0.1 * by);
    if (by < 0) return this.seek(at >= 0 && this.time - times[at] > 1e-3 ? times[at] : at > 0 ? times[at - 1] : this.replay.first);
    return this.seek(at + 1 < times.length ? times[at + 1] : this.replay.last);
  }

  draw() {
    this.dirty = false;
    const now = this.drawn = this.stage.at(this.time, LAYERS);
    $("clock").textContent = `${this.time.toFixed(2)} / ${this.replay.last.toFixed(2)} s`;
    $("scrub").value = this.time;
    this.labels(now); this.numbers(now); this.timeline();
    if (this.listed !== now.cycle) this.cycle(now.cycle);
    this.listed = now.cycle;
  }

  labels({ me, it, plan }) {
    const wanted = [["defender", me, "#0072B2", LAYERS.defender.on], ["target", it, "#B54A00", this.replay.knowsTarget && LAYERS.target.on]];
    if (plan && plan.meets) wanted.push(["meeting", plan.meets, "#7A5F00", LAYERS.meeting.on]);
    if (plan) wanted.push(["stop", plan.stop, "#004D38", LAYERS.stop.on]);
    const box = $("labels"), taken = [];
    box.replaceChildren();
    for (const [text, place, colour, on] of wanted) {
      const at = on && this.stage.scene.screen(place);
      if (!at) continue;
      let y = at.y - 34;
      for (const other of taken) if (Math.abs(other.x - at.x) < 74 && Math.abs(other.y - y) < 20) y = other.y - 21;
      taken.push({ x: at.x, y });
      const label = element("span", text, { style: `color:${colour};transform:translate(calc(${at.x.toFixed(1)}px - 50%), ${y.toFixed(1)}px)` });
      box.append(label);
    }
  }

  numbers({ me, it }) {
    const apart = Math.hypot(...minus(me, it)), speed = this.replay.between(this.replay.speed, this.time);
    const cells = [[number(speed, 1), "m/s"], [number(apart, 2), "m to the target"], [number(me[2] - this.replay.data.bounds[0][2], 2), "m above the floor"]];
    $("now").replaceChildren(...cells.map(([value, unit]) => { const cell = element("div"); cell.append(element("b", value), element("small", unit)); return cell; }));
  }

  cycle(index) {
    const { data } = this.replay, cycle = data.cycles[index], box = $("cycle");
    $("cycle-title").textContent = cycle ? `Cycle ${index + 1} of ${data.cycles.length}, at ${cycle.time.toFixed(2)} s` : "Cycle";
    if (!cycle) return box.replaceChildren(element("p", data.cycles.length ? "Before the departure: hovering." : "This run kept no cycles: fly it again to see candidates.", { style: "margin:0" }));
    const status = data.statuses[cycle.status], pill = element("span", status.text, { class: "pill", style: `background:${status.colour}` });
    const plan = data.plans[this.replay.committed[index]], facts = [];
    if (plan) facts.push([plan.meets ? "meets the target in" : "the target is there in", number(plan.arrival - cycle.time, 2, "s")], ["alpha", number(plan.alpha, 2)], ["probability of being tracked", number(plan.probability, 2)]);
    if (cycle.sooner > 0) facts.push(["sooner by refining", number(1000 * cycle.sooner, 0, "ms")]);
    facts.push(["takes over after", number(1000 * cycle.latency, 0, "ms")], ["off the reference", number(100 * cycle.deviation, 1, "cm")]);
    if (cycle.notes.length) facts.push(["note", cycle.notes.join(", ")]);
    const list = element("dl", undefined, { class: "rows" });
    for (const [name, value] of facts) list.append(element("dt", name), element("dd", value));
    const stages = Object.entries(cycle.stages).map(([name, ms], i) => [name, ms, STAGES[i % STAGES.length], number(ms, 1, "ms")]);
    const groups = data.groups.map(({ name, colour }, i) => [name, cycle.groups[i], colour, cycle.groups[i]]).filter((row) => row[1]);
    const reasons = element("ul", undefined, { class: "list", style: "color:var(--soft)" });
    for (const [name, count] of Object.entries(cycle.rejected)) { const row = element("li"); row.append(element("span", data.reasons[name] || name), element("span", count)); reasons.append(row); }
    box.replaceChildren(pill, list, ...shares("Candidates", cycle.generated, groups), ...(groups.length ? [element("small", "Reasons, of which one may have several", { style: "color:var(--soft)" })] : []), reasons,
      ...shares("Planning", number(stages.reduce((sum, row) => sum + row[1], 0), 0, "ms"), stages.filter((row) => row[1] > 0)));
  }

  layers() {
    for (const [name, layer] of Object.entries(LAYERS)) {
      if (name === "cut" && this.replay.data.ceiling === null) continue;
      const label = element("label"), box = element("input", undefined, { type: "checkbox" }), [kind, colour] = layer.mark;
      box.checked = layer.on; layer.box = box;
      box.addEventListener("change", () => { layer.on = box.checked; this.dirty = true; });
      const solid = kind === "dot" || kind === "area";
      label.append(box, element("i", undefined, { class: kind, style: solid ? `background:${colour}` : `border-color:${colour}` }), element("span", layer.label));
      $("layers").append(label);
    }
  }

  timeline() {
    const canvas = $("timeline"), ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight, { first, last, apart, times, speed } = this.replay;
    canvas.width = w * ratio; canvas.height = h * ratio;
    const pen = canvas.getContext("2d"), x = (t) => 2 + (w - 4) * (t - first) / Math.max(last - first, 1e-9), base = h - 16;
    pen.scale(ratio, ratio); pen.font = "11px system-ui, sans-serif";
    const path = (values, most) => { pen.beginPath(); values.forEach((v, i) => pen.lineTo(x(times[i]), base - (base - 6) * Math.min(v / most, 1))); };
    if (this.replay.knowsTarget) {
      path(apart, Math.max(...apart)); pen.lineTo(x(last), base); pen.lineTo(x(first), base); pen.fillStyle = "#f6e3d6"; pen.fill();
      pen.fillStyle = "#B54A00"; pen.fillText(`distance, up to ${Math.max(...apart).toFixed(1)} m`, 6, 13);
    }
    path(speed, Math.max(...speed, 1)); pen.strokeStyle = "#0072B2"; pen.lineWidth = 1.6; pen.stroke();
    pen.fillStyle = "#0072B2"; pen.fillText(`speed, up to ${Math.max(...speed).toFixed(1)} m/s`, this.replay.knowsTarget ? 140 : 6, 13);
    for (const cycle of this.replay.data.cycles) { pen.fillStyle = this.replay.data.statuses[cycle.status].colour; pen.fillRect(x(cycle.time) - 1, base + 2, 2.4, 12); }
    pen.fillStyle = "#1d2530"; pen.fillRect(x(this.time) - 1, 0, 2, h);
  }

  buttons() {
    const camera = this.stage.scene.camera, follow = (on) => { this.stage.follows = on; $("follow").setAttribute("aria-pressed", on); this.dirty = true; };
    const actions = {
      play: () => this.play(!this.playing), back: () => this.step(-1), forth: () => this.step(1),
      top: () => { camera.elevation = Math.PI / 2 - 1e-3; camera.azimuth = -Math.PI / 2; if (!this.stage.follows) { camera.centre = new Camera(camera.bounds).centre; camera.fit(); } this.dirty = true; },
      whole: () => { follow(false); const { centre, azimuth, elevation } = new Camera(camera.bounds); Object.assign(camera, { centre, azimuth, elevation }); camera.fit(); this.dirty = true; },
      follow: () => { const on = !this.stage.follows; if (on) camera.distance = Math.min(camera.distance, Math.max(5, 0.3 * camera.reach)); follow(on); },
    };
    for (const [id, action] of Object.entries(actions)) $(id).addEventListener("click", action);
    $("scrub").addEventListener("input", () => { this.play(false); this.seek(Number($("scrub").value)); });
    const keys = { " ": actions.play, ArrowLeft: actions.back, ArrowRight: actions.forth, f: actions.follow, t: actions.top, 0: actions.whole, ",": () => this.seek(this.time - 0.02), ".": () => this.seek(this.time + 0.02), p: () => LAYERS.padding.box.click() };
    window.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT" || (event.key === " " && event.target.tagName === "BUTTON")) return;
      const action = keys[event.key];
      if (action) { event.preventDefault(); action(); }
    });
  }

  camera() {
    const canvas = $("scene"), camera = this.stage.scene.camera, held = new Map();
    const zoom = (factor) => { camera.distance = Math.min(Math.max(camera.distance * factor, 0.5), 4 * camera.reach); this.dirty = true; };
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(0.0012 * event.deltaY)); }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); held.set(event.pointerId, event); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
      if (held.size > 1) {
        const other = [...held.values()].find((each) => each.pointerId !== event.pointerId), far = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY);
        zoom(far(before) / Math.max(far(event), 1)); camera.pan(dx / 2, dy / 2, canvas.clientHeight);
      } else if (event.shiftKey || event.buttons & 2) { camera.pan(dx, dy, canvas.clientHeight); } else {
        camera.azimuth -= 0.006 * dx; camera.elevation = Math.min(Math.max(camera.elevation + 0.006 * dy, -0.2), Math.PI / 2 - 1e-3);
      }
      held.set(event.pointerId, event); this.dirty = true;
    });
  }
}

function shares(title, total, parts) {
  const head = element("h3"), bar = element("div", undefined, { class: "bar" }), list = element("ul", undefined, { class: "list" });
  const sum = parts.reduce((so, [, value]) => so + value, 0) || 1;
  head.append(element("span", title), element("span", total));
  for (const [name, value, colour, text] of parts) {
    bar.append(element("i", undefined, { style: `background:${colour};width:${100 * value / sum}%` }));
    const row = element("li"), left = element("span");
    left.append(element("span", "", { class: "chip", style: `background:${colour}` }), name);
    row.append(left, element("span", text)); list.append(row);
  }
  return [head, bar, list];
}

// For whoever looks at the page from a program: `ready`, `seek(time)` and `state()`.
window.jaxplan = { ready: false, error: null };
try {
  const player = new Player(JSON.parse($("data").textContent));
  window.jaxplan = {
    ready: true, error: null, player, layers: LAYERS,
    seek: (time) => { player.play(false); player.seek(time); player.draw(); },
    state: () => { player.draw(); return { time: player.time, cycle: player.drawn.cycle, covered: player.stage.scene.covered(), nodes: Object.fromEntries(player.stage.shown.map((n) => [n.name, n.models ? n.count * n.models.length : n.count])) }; },
  };
} catch (error) {
  window.jaxplan.error = String(error);
  $("message").textContent = `This replay cannot be shown: ${error.message}.`;
}
