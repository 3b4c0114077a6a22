// The page of `egotac view`: asks for moments as time goes on, and shows each.

import { Chart } from "/chart.js";
import { HandPanels, SeenHands } from "/hands.js";
import { Link } from "/link.js";

/** Largest number of points of a curve that grows while it is watched. */
const MAX_POINTS = 6000;
/** Time of a live source that the curve shows, s. */
const LIVE_SECONDS = 20;
/** Number of images by which a recording may lag before it is played more slowly. */
const MAX_LAG = 3;

const at = id => document.getElementById(id);
const SIDES = ["left", "right"];
const about = await (await fetch("/about")).json();
const toLinear = byte => (byte / 255) ** 2.2;
const ramp = about.ramp.map(color => color.map(toLinear));
const unknown = about.unknown.map(toLinear);

const state = {
  source: 0, playing: false, speed: 1, moment: null, meshes: [], base: null, busy: false, pending: null,
  points: [], version: 0,  // points of the curve, and a number that changes with them
  sequence: 0,  // number of the newest moment of a live source that came
  run: 0, ahead: null,  // number that changes when playing is interrupted, and that of the request under way if it was made ahead
  drawn: Promise.resolve(),  // until the moment before is drawn
};
const shown = { updates: 0, skipped: 0, times: [] };
const source = () => about.sources[state.source];
const isLive = () => source().kind === "live";

let panels, seenHands;
try {
  panels = new HandPanels(at("hands"), () => drawHands());
  seenHands = new SeenHands(at("overlay"));
} catch (error) {
  notice(error.message);
}
const chart = new Chart(at("chart"), at("now"), stamp => !isLive() && seek(frameAt(stamp)));
const link = new Link(answered, text => notice(text));

function notice(text) {
  at("notice").textContent = text;
  at("notice").hidden = !text;
  document.body.dataset.notice = text;
}

/** Colours of the vertices by force; NaN is the colour of the unknown. */
function colors(force) {
  const made = new Float32Array(3 * force.length);
  force.forEach((value, vertex) => {
    const color = Number.isNaN(value) ? unknown : ramp[Math.round(Math.max(0, Math.min(1, value / source().scale)) * (ramp.length - 1))];
    made.set(color, 3 * vertex);
  });
  return made;
}

/** Says how much force there is; unknown is never a number. */
const newtons = force => force === null ? "unknown" : `${force.toFixed(2)} N`;

// ---- asking

/**
 * Asks for a frame of a recording, or for the next moment of a live source. A frame that is asked for ahead is shown when it is
 * due, unless playing was interrupted meanwhile.
 */
function ask(frame, ahead = false) {
  if (state.busy && !isLive()) {
    state.pending = frame;
    return;
  }
  state.busy = true;
  state.ahead = ahead ? state.run : null;
  link.ask(isLive() ? { source: state.source, after: state.sequence } : { source: state.source, frame });
}

async function answered(answer, wanted) {
  const { ahead } = state;
  const interrupted = () => ahead !== null && ahead !== state.run;
  state.busy = false;
  // The source was changed meanwhile.
  if (wanted && wanted.source !== state.source) return ask(state.pending ?? 0);
  if (answer.failed) {
    notice(answer.failed);
    return pause();
  }
  // Images are decoded while the one before is drawn, and the next one comes while this one is drawn; they are shown in order.
  const picture = answer.image ? createImageBitmap(answer.image) : null;
  const before = state.drawn;
  let done;
  state.drawn = new Promise(resolve => { done = resolve; });
  try {
    await before;
    if (answer.end !== undefined) {
      if (source().frames === null) source().frames = answer.end;
      pause();
      return follow();
    }
    if (interrupted()) return follow();
    state.sequence = answer.sequence;
    follow(answer.frame);
    if (ahead !== null) await due(answer.frame);
    if (interrupted()) return;
    show(answer, await picture);
    if (state.playing && answer.frame + 1 >= (source().frames ?? Infinity)) pause();
  } finally {
    done();
    (await picture)?.close();
  }
}

/** Asks for what comes next, behind the image `frame`, or behind the one that is shown. */
function follow(frame = state.moment?.frame ?? 0) {
  const { pending } = state;
  state.pending = null;
  if (isLive()) ask();
  else if (pending !== null) ask(pending);
  else if (state.playing && !state.busy) next(frame);
}

/** Asks for the image behind `frame`; images whose time is over are left out. */
function next(frame) {
  const last = (source().frames ?? Infinity) - 1;
  if (frame >= last) return;
  const fps = source().fps ?? 25;
  const due = state.base.frame + Math.floor((performance.now() - state.base.time) / 1000 * fps * state.speed);
  // A network or browser that can't keep up plays more slowly, and does not leave out more and more.
  const following = Math.max(frame + 1, Math.min(due, frame + MAX_LAG, last));
  if (due > following) state.base = { frame: following, time: performance.now() };
  shown.skipped += following - frame - 1;
  ask(following, true);
}

/** Waits until an image is due. */
function due(frame) {
  const wait = (frame - state.base.frame) / ((source().fps ?? 25) * state.speed) * 1000 - (performance.now() - state.base.time);
  return wait > 1 ? new Promise(resolve => { setTimeout(resolve, wait); }) : null;
}

function play() {
  const { frame } = state.moment ?? { frame: 0 };
  const ended = source().frames !== null && frame + 1 >= source().frames;
  state.playing = true;
  state.base = { frame: ended ? 0 : frame, time: performance.now() };
  at("play").textContent = "Pause";
  if (ended) ask(0);
  else if (!state.busy) next(frame);
}

function pause() {
  state.playing = false;
  state.run += 1;
  at("play").textContent = "Play";
}

function seek(frame) {
  state.run += 1;
  state.base = { frame, time: performance.now() };
  ask(frame);
}

/** Returns the frame at a time of the curve. */
function frameAt(stamp) {
  const nearest = state.points.reduce((best, point) => Math.abs(point.stamp - stamp) < Math.abs(best.stamp - stamp) ? point : best);
  return nearest.frame;
}

// ---- showing

function show(moment, picture) {
  state.moment = moment;
  if (picture) drawImage(picture, moment.size);
  else {
    const g = imageContext();
    g.clearRect(0, 0, at("image").width, at("image").height);
  }
  at("reason").textContent = moment.fault ?? (moment.reason ? `Touch is unknown: ${moment.reason}` : "");
  at("reason").hidden = !at("reason").textContent;
  at("truth-legend").hidden = !moment.truth_total;
  remember(moment);
  drawHands();
  drawRegions();
  chart.draw(state.points, time(moment), source().familiarity_threshold, state.version);
  badges(moment);
  count(moment);
}

/** Context of the image: without a GPU, the browser draws images much faster into memory. */
const imageContext = () => at("image").getContext("2d", { willReadFrequently: true });

function drawImage(picture, [width, height]) {
  for (const canvas of [at("image"), at("overlay")]) {
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  }
  imageContext().drawImage(picture, 0, 0);
}

function drawHands() {
  const { moment, meshes } = state;
  if (!moment || !panels || meshes.length === 0) return;
  const row = force => meshes.map((mesh, side) => ({
    mesh,
    positions: moment[`${SIDES[side]}_posed`] ?? mesh.rest,
    colors: colors(force.subarray(778 * side, 778 * (side + 1))),
  }));
  const rows = [row(moment.force), ...(moment.truth ? [row(moment.truth)] : [])];
  panels.draw(rows);
  const hands = meshes.map((mesh, side) => ({ mesh, seen: moment[`${SIDES[side]}_seen`], colors: rows[0][side].colors }));
  seenHands.draw(at("shows-overlay").checked ? hands.filter(hand => hand.seen) : []);
  labels(rows.length, moment);
}

function labels(rows, moment) {
  const names = [["", moment.total], ["truth, ", moment.truth_total]].slice(0, rows);
  at("labels").replaceChildren(...names.flatMap(([name, total], row) => SIDES.map((side, column) => {
    const label = document.createElement("span");
    label.className = side;
    label.style.left = `${25 + 50 * column}%`;
    label.style.top = `${100 * row / rows}%`;
    label.textContent = `${name}${side}: ${newtons(total[side === "left" ? 0 : 1])}`;
    return label;
  })));
}

/** Returns the time of a moment on the curve: stamps of a recording may begin anew in each episode, so images are counted. */
function time({ frame, stamp }) {
  return isLive() ? stamp : frame / (source().fps ?? 25);
}

/** Keeps the forces of a moment for the curve, unless the recording's whole course is known. */
function remember(moment) {
  if (source().course) return;
  state.version += 1;
  const point = { frame: moment.frame, stamp: time(moment), force: moment.total, truth: moment.truth_total, familiarity: moment.familiarity };
  const { points } = state;
  if (isLive()) {
    if (points.length && points[points.length - 1].stamp >= point.stamp) points.length = 0;
    points.push(point);
    while (points[0].stamp < point.stamp - LIVE_SECONDS) points.shift();
    return;
  }
  let place = points.length;
  while (place > 0 && points[place - 1].frame >= point.frame) place -= 1;
  points.splice(place, points[place]?.frame === point.frame ? 1 : 0, point);
  if (points.length > MAX_POINTS) points.splice(0, points.length - MAX_POINTS);
}

function drawRegions() {
  const { moment, names } = state;
  const largest = Math.max(1, ...moment.regions.filter(force => force !== null), ...(moment.truth_regions ?? []).filter(force => force !== null));
  const rows = at("regions").tBodies[0].rows;
  names.forEach((_, region) => [0, 1].forEach(side => {
    const cells = rows[region].cells;
    const [value, track] = side === 0 ? [cells[0], cells[1].firstChild] : [cells[4], cells[3].firstChild];
    const force = moment.regions[17 * side + region], truth = moment.truth_regions?.[17 * side + region];
    value.textContent = newtons(force) + (truth === undefined ? "" : ` (${truth === null ? "?" : truth.toFixed(2)})`);
    track.classList.toggle("unknown", force === null);
    const [bar, mark] = track.children;
    bar.style.width = `${100 * (force ?? 0) / largest}%`;
    mark.hidden = !(truth > 0);
    mark.style[side === 0 ? "right" : "left"] = `calc(${100 * Math.min(1, (truth ?? 0) / largest)}% - 2px)`;
  }));
}

function badges(moment) {
  const badge = (id, name, value, threshold) => {
    const doubtful = value !== null && threshold !== null && value < threshold;
    at(id).textContent = value === null ? `${name}: not estimated` : `${name} ${value.toFixed(2)}`;
    at(id).className = `badge ${value === null ? "unknown" : doubtful ? "doubt" : ""}`;
  };
  badge("familiarity", "familiarity", moment.familiarity, source().familiarity_threshold);
  SIDES.forEach((side, index) => badge(`presence-${side}`, side, moment.presence[index], source().presence_threshold));
}

function count(moment) {
  const now = performance.now();
  shown.updates += 1;
  shown.times.push(now);
  while (shown.times[0] < now - 2000) shown.times.shift();
  const span = (now - shown.times[0]) / 1000;
  const rate = shown.times.length > 1 ? (shown.times.length - 1) / span : 0;
  const dropped = isLive() ? moment.dropped : shown.skipped;
  at("rate").textContent = `${rate.toFixed(0)} images/s, ${dropped} left out`;
  const frames = source().frames;
  at("frame").max = Math.max((frames ?? 0) - 1, moment.frame);
  at("frame").value = moment.frame;
  at("time").textContent = `${moment.stamp.toFixed(2)} s, image ${moment.frame + 1}${frames === null ? "" : ` of ${frames}`}`;
  Object.assign(document.body.dataset, {
    source: state.source, frame: moment.frame, updates: shown.updates, rate: rate.toFixed(1), dropped, playing: state.playing,
    total: JSON.stringify(moment.total), truth: JSON.stringify(moment.truth_total ?? null),
  });
}

// ---- choosing

async function choose(index) {
  pause();
  const meshes = await (await fetch(`/hands/${index}`)).json();
  Object.assign(state, { source: index, moment: null, points: [], names: meshes.region_names, pending: null, sequence: 0 });
  state.version += 1;
  Object.assign(shown, { skipped: 0, times: [] });
  state.meshes = meshes.hands.map(hand => ({ ...hand, faces: new Uint16Array(hand.faces), rest: new Float32Array(hand.rest) }));
  const { course } = source();
  if (course) {
    state.points = course.force[0].map((_, point) => ({
      frame: point * course.step, stamp: time({ frame: point * course.step }), force: course.force.map(force => force[point]),
      truth: course.truth[0].length ? course.truth.map(force => force[point]) : null,
      familiarity: course.familiarity[point] ?? null,
    }));
  }
  at("touch").textContent = source().touch;
  at("familiarity-legend").hidden = source().familiarity_threshold === null;
  at("controls").style.display = isLive() ? "none" : "";
  at("ticks").replaceChildren(...[0, 0.5, 1].map(share => {
    const tick = document.createElement("span");
    tick.textContent = `${(share * source().scale).toFixed(source().scale < 5 ? 2 : 1)} N${share === 1 ? " and more" : ""}`;
    return tick;
  }));
  const rows = state.names.map((name, region) => {
    const row = document.createElement("tr");
    const [red, green, blue] = about.region_colors[region];
    row.innerHTML = '<td class="value"></td><td><div class="track flip"><i></i><b hidden></b></div></td><td class="name"></td>' +
      '<td><div class="track"><i></i><b hidden></b></div></td><td class="value"></td>';
    row.querySelector(".name").textContent = name;
    row.querySelectorAll("i").forEach(bar => { bar.style.background = `rgb(${red * 0.8}, ${green * 0.8}, ${blue * 0.8})`; });
    return row;
  });
  at("regions").tBodies[0].replaceChildren(...rows);
  state.busy = false;
  ask(0);
}

function drawBar() {
  const g = at("bar").getContext("2d");
  const { width, height } = at("bar");
  for (let x = 0; x < width; x += 1) {
    const [red, green, blue] = about.ramp[Math.round(x / (width - 1) * (about.ramp.length - 1))];
    g.fillStyle = `rgb(${red}, ${green}, ${blue})`;
    g.fillRect(x, 0, 1, height);
  }
}

about.sources.forEach((of, index) => at("source").add(new Option(of.name, index)));
at("source").addEventListener("change", () => choose(Number(at("source").value)));
at("play").addEventListener("click", () => state.playing ? pause() : play());
at("speed").addEventListener("change", () => {
  state.speed = Number(at("speed").value);
  state.run += 1;
  state.base = { frame: state.moment?.frame ?? 0, time: performance.now() };
});
at("frame").addEventListener("input", () => seek(Number(at("frame").value)));
at("shows-overlay").addEventListener("change", drawHands);
document.addEventListener("keydown", event => {
  if (event.target.matches("input[type=range], select")) return;
  if (event.key === " ") {
    event.preventDefault();
    at("play").click();
  }
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (step && state.moment && !isLive()) seek(Math.max(0, state.moment.frame + step));
});
drawBar();
await choose(0);
