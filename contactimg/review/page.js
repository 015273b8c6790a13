"use strict";

/* The page of `contactimg review`. Coordinates: image pixels, (0, 0) the centre of the top-left pixel, y down.
   Sections: state, server, view and drawing, contacts, edits, threshold, frames, mouse and keys, start. */

// ---- state

const byId = (id) => document.getElementById(id);
const EDIT_FIELDS = ["frame", "action", "x_px", "y_px", "radius_px", "points", "author", "time", "reason"];
const EDIT_COLOUR = "#cc79a7", SELECTED_COLOUR = "#ffffff", ABOVE_COLOUR = [230, 159, 0];
const REACH_PX = 2; // a contact is meant within this distance of its centre, as when edits are applied
const state = {
  run: null, number: 0, data: null, contacts: [], rejected: [], image: null, size: [1, 1],
  light: null, above: null, curves: null, tool: "select", selected: [], hover: null, draft: null, drag: null,
  undo: [], redo: [], unsaved: 0, hidden: new Set(), show: { rejected: true, edits: true },
  view: { x: 0, y: 0, scale: 1 }, drawTimes: [],
};
const view = byId("view"), layer = document.createElement("canvas");
let layerOf = null; // what the layer shows: place, scale and size

// ---- server; all addresses are relative, so that a forwarded port works

async function ask(path, data) {
  const options = data === undefined ? {} :
    { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(data) };
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw Object.assign(new Error("the server does not answer; has it been ended?"), { lost: true });
  }
  const body = await answer.json();
  if (answer.status === 503) throw Object.assign(new Error(`${body.error}.`), { lost: true });
  if (!answer.ok) throw new Error(body.error || `the server answered ${answer.status}`);
  return body;
}

function tell(text, isError = false) {
  byId("state").textContent = text;
  byId("state").classList.toggle("error", isError);
}

const attempt = (promise) => promise.catch((error) => { if (!error.lost || !state.unsaved) tell(error.message, true); });

// ---- view and drawing

const toScreen = (x, y) => [(x - state.view.x) * state.view.scale, (y - state.view.y) * state.view.scale];
const toImage = (sx, sy) => [sx / state.view.scale + state.view.x, sy / state.view.scale + state.view.y];

function fit() {
  const [columns, rows] = state.size, box = view.getBoundingClientRect();
  const scale = Math.min(box.width / columns, box.height / rows) * 0.98;
  state.view = { scale, x: (columns - 1) / 2 - box.width / 2 / scale, y: (rows - 1) / 2 - box.height / 2 / scale };
  draw();
}

function zoom(factor, sx, sy) {
  const [x, y] = toImage(sx, sy);
  const scale = Math.min(Math.max(state.view.scale * factor, 0.02), 80);
  state.view = { scale, x: x - sx / scale, y: y - sy / scale };
  showPlace(x, y);
  draw();
}

/* After a change of the window the middle of the picture stays in the middle. */
let lastSize = null;
function keepMiddle() {
  const size = [view.clientWidth, view.clientHeight];
  if (lastSize) {
    state.view.x -= (size[0] - lastSize[0]) / 2 / state.view.scale;
    state.view.y -= (size[1] - lastSize[1]) / 2 / state.view.scale;
  }
  lastSize = size;
  draw();
}

let drawing = false;
function draw() {
  if (drawing || !state.run) return;
  drawing = true;
  requestAnimationFrame(() => { drawing = false; drawNow(); });
}

function drawNow() {
  const start = performance.now(), ratio = window.devicePixelRatio || 1;
  const width = view.clientWidth, height = view.clientHeight;
  if (view.width !== Math.round(width * ratio) || view.height !== Math.round(height * ratio)) {
    view.width = Math.round(width * ratio);
    view.height = Math.round(height * ratio);
    layerOf = null;
  }
  const pen = view.getContext("2d", { alpha: false });
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = "#14181d";
  pen.fillRect(0, 0, width, height);
  drawImages(pen);
  blitContacts(pen, width, height, ratio);
  if (state.show.edits) drawEdits(pen);
  drawSelection(pen);
  drawDraft(pen);
  state.drawTimes.push(performance.now() - start);
  if (state.drawTimes.length > 500) state.drawTimes.shift();
}

function drawImages(pen) {
  const { scale } = state.view, [left, top] = toScreen(-0.5, -0.5), [columns, rows] = state.size;
  pen.imageSmoothingEnabled = scale < 1;
  if (state.image) pen.drawImage(state.image, left, top, columns * scale, rows * scale);
  if (state.above && byId("show-light").checked) pen.drawImage(state.above, left, top, columns * scale, rows * scale);
}

/* The contacts are drawn on a layer, half a window wider on each side as far as the frame reaches; a drag only
   copies it. While many contacts are zoomed it is copied at another size and drawn anew afterwards. */
function blitContacts(pen, width, height, ratio) {
  const [left, top] = toImage(0, 0), [right, bottom] = toImage(width, height), { scale } = state.view;
  const box = ofFrame(left, top, right, bottom);
  const covered = layerOf && box[0] >= layerOf.box[0] && box[1] >= layerOf.box[1] && box[2] <= layerOf.box[2] && box[3] <= layerOf.box[3];
  const zoomed = layerOf && layerOf.scale !== scale;
  window.clearTimeout(sharpTimer);
  if (!layerOf || (!covered && !zoomed) || (zoomed && state.contacts.length < MANY)) drawLayer(width, height, ratio);
  else if (zoomed) sharpTimer = window.setTimeout(() => { layerOf = null; draw(); }, 90);
  const place = toScreen(layerOf.box[0], layerOf.box[1]), size = scale / layerOf.scale;
  // whole pixels of the screen: else every copy would be blurred
  const snap = (value) => Math.round(value * ratio) / ratio;
  pen.drawImage(layer, snap(place[0]), snap(place[1]), (layer.width / ratio) * size, (layer.height / ratio) * size);
}

const MANY = 1500;
let sharpTimer = 0;

/* The part of a box (left, top, right, bottom; image px) in which contacts can be. */
function ofFrame(left, top, right, bottom) {
  const [columns, rows] = state.size, rim = 0.1 * Math.max(columns, rows) + 20 / state.view.scale;
  const inside = (value, size) => Math.min(Math.max(value, -rim), size + rim);
  return [inside(left, columns), inside(top, rows), inside(right, columns), inside(bottom, rows)];
}

function drawLayer(width, height, ratio) {
  const { scale } = state.view, margin = Math.max(width, height) / 2;
  const box = ofFrame(...toImage(-margin, -margin), ...toImage(width + margin, height + margin));
  const size = [Math.ceil((box[2] - box[0]) * scale * ratio) + 1, Math.ceil((box[3] - box[1]) * scale * ratio) + 1];
  const pen = layer.getContext("2d");
  if (layer.width !== size[0] || layer.height !== size[1]) [layer.width, layer.height] = size;
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.clearRect(0, 0, layer.width, layer.height);
  layerOf = { scale, box };
  const [x, y] = toScreen(box[0], box[1]);
  pen.setTransform(ratio, 0, 0, ratio, -x * ratio, -y * ratio);
  const inside = (place, reach) => place.x > box[0] - reach && place.x < box[2] + reach && place.y > box[1] - reach && place.y < box[3] + reach;
  for (const kind of state.run.kinds) {
    if (state.hidden.has(kind.name)) continue;
    const small = new Path2D(), large = new Path2D(); // dashes do not show on small ones
    let count = 0;
    for (const contact of state.contacts) {
      if (contact.kind !== kind || !inside(contact, contact.major)) continue;
      addContact(contact.major * scale < 8 ? small : large, contact);
      count += 1;
    }
    if (!count) continue;
    strokeTwice(pen, small, kind.colour, [], count);
    strokeTwice(pen, large, kind.colour, kind.dashes, count);
  }
  if (state.show.rejected) drawRejected(pen, inside);
}

/* The line runs just outside the rim, which stays visible. */
function addContact(path, contact) {
  const { scale } = state.view, [sx, sy] = toScreen(contact.x, contact.y);
  if (contact.lines) {
    for (const line of contact.lines) {
      line.forEach(([x, y], k) => { const at = toScreen(x, y); k ? path.lineTo(...at) : path.moveTo(...at); });
      path.closePath();
    }
    return;
  }
  const a = contact.major * scale + 1.2, b = contact.minor * scale + 1.2;
  path.moveTo(sx + a * Math.cos(contact.angle), sy + a * Math.sin(contact.angle));
  if (a === b) path.arc(sx, sy, a, 0, 2 * Math.PI);
  else path.ellipse(sx, sy, a, b, contact.angle, 0, 2 * Math.PI);
}

function strokeTwice(pen, path, colour, dashes, count = 1) {
  pen.setLineDash([]);
  if (count < MANY) {
    pen.strokeStyle = "#0009";
    pen.lineWidth = 3;
    pen.stroke(path);
  }
  pen.setLineDash(dashes);
  pen.strokeStyle = colour;
  pen.lineWidth = 1.5;
  pen.stroke(path);
  pen.setLineDash([]);
}

function drawRejected(pen, inside) {
  const path = new Path2D(), { scale } = state.view;
  for (const spot of state.rejected) {
    if (!inside(spot, spot.radius)) continue;
    const [sx, sy] = toScreen(spot.x, spot.y), arm = Math.max(4, Math.min(0.7 * spot.radius * scale, 12));
    path.moveTo(sx - arm, sy - arm); path.lineTo(sx + arm, sy + arm);
    path.moveTo(sx - arm, sy + arm); path.lineTo(sx + arm, sy - arm);
  }
  strokeTwice(pen, path, state.run.rejected.colour, [], state.rejected.length);
}

const editsOfFrame = () => state.run.edits
  .map((row, place) => ({ row, place }))
  .filter(({ row }) => row.frame === "*" || row.frame === state.run.frames[state.number].name);
const pointsOf = (text) => (text || "").split(";").filter((part) => part.trim())
  .map((part) => part.trim().split(/\s+/).map(Number));

function drawEdits(pen) {
  const pending = state.run.frames[state.number].pending;
  pen.globalAlpha = pending ? 1 : 0.45;
  for (const { row } of editsOfFrame()) drawEdit(pen, row);
  pen.globalAlpha = 1;
}

function drawEdit(pen, row) {
  const path = new Path2D(), points = pointsOf(row.points).map(([x, y]) => toScreen(x, y));
  const [sx, sy] = row.x_px === null ? [0, 0] : toScreen(row.x_px, row.y_px);
  const radius = row.radius_px === null ? 7 : row.radius_px * state.view.scale;
  if (row.action === "exclude") {
    path.moveTo(sx - 6, sy - 6); path.lineTo(sx + 6, sy + 6); path.moveTo(sx - 6, sy + 6); path.lineTo(sx + 6, sy - 6);
  } else if (row.action === "add" || (row.action === "mask" && !points.length)) {
    path.arc(sx, sy, radius, 0, 2 * Math.PI);
  } else if (row.action === "mask") {
    points.forEach((at, k) => (k ? path.lineTo(...at) : path.moveTo(...at)));
    path.closePath();
  } else if (row.action === "merge") {
    points.forEach((at, k) => (k ? path.lineTo(...at) : path.moveTo(...at)));
  } else {
    for (const [x, y] of points.length ? points : [[sx - 4, sy], [sx + 4, sy]]) { path.moveTo(x + 3, y); path.arc(x, y, 3, 0, 7); }
  }
  if (row.action === "mask") { pen.fillStyle = EDIT_COLOUR + "55"; pen.fill(path); }
  strokeTwice(pen, path, EDIT_COLOUR, [4, 3]);
}

function drawSelection(pen) {
  for (const contact of state.selected) {
    const path = new Path2D();
    addContact(path, contact);
    pen.strokeStyle = "#000"; pen.lineWidth = 6; pen.stroke(path);
    strokeTwice(pen, path, SELECTED_COLOUR, []);
  }
}

function drawDraft(pen) {
  const draft = state.draft;
  if (!draft) return;
  const path = new Path2D(), points = (draft.points || []).map(([x, y]) => toScreen(x, y));
  if (draft.action === "add") path.arc(...toScreen(draft.x, draft.y), Math.max(draft.radius * state.view.scale, 1), 0, 7);
  if (draft.action === "mask") points.forEach((at, k) => (k ? path.lineTo(...at) : path.moveTo(...at)));
  if (draft.action === "mask" && draft.cursor && points.length) path.lineTo(...toScreen(...draft.cursor));
  for (const [x, y] of points) { path.moveTo(x + 3, y); path.arc(x, y, 3, 0, 7); }
  strokeTwice(pen, path, EDIT_COLOUR, []);
}

// ---- contacts

function takeContacts(data) {
  const { contacts, rejected, outlines } = data;
  state.data = data;
  state.contacts = contacts.label.map((label, k) => ({
    label, x: contacts.x_px[k], y: contacts.y_px[k],
    major: contacts.semi_major_px[k] ?? contacts.radius_px[k], minor: contacts.semi_minor_px[k] ?? contacts.radius_px[k],
    angle: contacts.angle_rad[k] ?? 0, lines: contacts.shape[k] === "free" ? outlines[label] : undefined,
    kind: state.run.kinds.find((kind) => !kind.flags || kind.flags & contacts.flags[k]), row: k,
  }));
  state.rejected = rejected.x_px.map((x, k) => ({ x, y: rejected.y_px[k], radius: rejected.radius_px[k] || 0, reason: rejected.reason[k] }));
  state.selected = [];
  layerOf = null;
}

function contactAt(x, y) {
  let best = null, least = 1;
  for (const contact of state.contacts) {
    const ratio = Math.hypot(contact.x - x, contact.y - y) / Math.max(contact.major, REACH_PX, 4 / state.view.scale);
    if (ratio <= least) { least = ratio; best = contact; }
  }
  return best;
}

function rejectedAt(x, y) {
  const near = (spot) => Math.hypot(spot.x - x, spot.y - y) <= Math.max(spot.radius, 6 / state.view.scale);
  return state.show.rejected ? state.rejected.find(near) : undefined;
}

function select(contacts) {
  state.selected = contacts;
  draw();
  attempt(showContact());
}

const flagsOf = (value) => Object.entries(state.run.flags).filter(([, bit]) => value & bit).map(([name]) => name);
const short = (value, digits = 5) => (value === null || value === undefined ? "" : Number(value.toPrecision(digits)).toString());
const withStd = (value, std, factor = 1) => short(value === null ? null : value * factor) + (std ? ` ± ${short(std * factor, 2)}` : "");

function numbersOf(contact) {
  const all = state.data.contacts, value = (name) => all[name][contact.row];
  const rows = [
    ["label", value("label")], ["x, y (px)", `${short(value("x_px"), 6)}, ${short(value("y_px"), 6)}`],
    ["radius (px)", withStd(value("radius_px"), value("radius_std_px"))],
  ];
  if (value("shape") !== "disk") rows.push(["shape", value("shape")], ["half-axes (px)", `${short(value("semi_major_px"), 4)}, ${short(value("semi_minor_px"), 4)}`]);
  if (value("area_m2") !== null) rows.push(["area (µm²)", short(value("area_m2") * 1e12)]);
  if (value("force_N") !== null) rows.push(["force (mN)", withStd(value("force_N"), value("force_std_N"), 1e3)]);
  if (value("asperity") !== null) rows.push(["asperity", value("asperity")]);
  rows.push(["flags", flagsOf(value("flags")).join(", ") || "none"]);
  return rows;
}

function fillTable(table, rows) {
  table.replaceChildren(...rows.map(([name, value]) => {
    const row = document.createElement("tr"), head = document.createElement("th"), cell = document.createElement("td");
    head.textContent = name; cell.textContent = value;
    row.append(head, cell);
    return row;
  }));
}

let asked = 0;
async function showContact() {
  const contact = state.selected[state.selected.length - 1], turn = ++asked;
  byId("contact-body").hidden = !contact;
  byId("contact-hint").textContent = contact ? "" : "Click a contact, or press Tab.";
  if (!contact) return;
  fillTable(byId("numbers"), numbersOf(contact));
  byId("residual-caption").textContent = "residual";
  for (const id of ["pixels", "model", "residual"]) byId(id).getContext("2d").clearRect(0, 0, 1e4, 1e4);
  const answer = await ask(`frames/${state.number}/contact/${contact.label}.json`);
  if (turn === asked) showWindow(answer);
}

function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Int16Array(bytes.buffer);
}

function showWindow(answer) {
  const pixels = unpacked(answer.pixels), model = unpacked(answer.model), sigma = Math.max(answer.noise * 1000, 5);
  const grey = (value) => { const level = (value / 1250) * 255; return [level, level, level]; };
  const signed = (value) => {
    const part = Math.min(Math.abs(value) / (6 * sigma), 1), end = value > 0 ? [213, 94, 0] : [0, 114, 178];
    return end.map((level) => 255 + (level - 255) * part);
  };
  paint("pixels", answer, (k) => grey(pixels[k]));
  paint("model", answer, (k) => grey(model[k]));
  paint("residual", answer, (k) => signed(pixels[k] - model[k]));
  byId("residual-caption").textContent = `residual ±${short(600 * sigma / 1000, 2)} %`;
}

function paint(id, answer, colour) {
  const canvas = byId(id), { columns, rows } = answer;
  canvas.width = columns; canvas.height = rows;
  const pen = canvas.getContext("2d"), data = pen.createImageData(columns, rows);
  for (let k = 0; k < columns * rows; k++) data.data.set([...colour(k), 255], 4 * k);
  pen.putImageData(data, 0, 0);
}

// ---- edits: sent one after the other; one counts as saved when the server has it on the disk

let queue = Promise.resolve();
const keyOf = (row) => JSON.stringify(EDIT_FIELDS.map((name) => row[name] ?? (name.endsWith("_px") ? null : "")));
const placeOf = (row) => state.run.edits.map(keyOf).lastIndexOf(keyOf(row));

function send(path, data) {
  state.unsaved += 1;
  tell(`saving ${state.unsaved} ...`);
  const sent = queue.then(() => untilAnswered(path, data));
  queue = sent.catch(() => undefined);
  return sent.finally(() => { state.unsaved -= 1; });
}

/* What was sent twice, because the answer was lost, is written once: the server knows it by its time. */
async function untilAnswered(path, data) {
  for (;;) {
    try {
      takeRun(await ask(path, data));
      return;
    } catch (error) {
      if (!error.lost) { // another page may have changed the edits
        takeRun(await ask("run.json"));
        showRun();
        throw error;
      }
      tell(`NOT SAVED: ${error.message} ${state.unsaved} kept here and sent again.`, true);
      await new Promise((wake) => setTimeout(wake, 1000));
    }
  }
}

async function addEdit(edit) {
  const everywhere = edit.action === "mask" && byId("all-frames").checked;
  const row = {
    frame: everywhere ? "*" : state.run.frames[state.number].name, x_px: null, y_px: null, radius_px: null, points: "",
    author: byId("author").value.trim(), time: new Date().toISOString(), reason: byId("reason").value.trim(), ...edit,
  };
  await send("edits/insert", { rows: [row] });
  state.undo.push({ did: "insert", row });
  state.redo = [];
  saved(`saved: ${row.action}`);
}

async function removeEdit(row, place) {
  await send("edits/remove", { row, place });
  state.undo.push({ did: "remove", row, place });
  state.redo = [];
  saved(`taken out: ${row.action}`);
}

async function stepBack(from, to, word) {
  const step = from.pop();
  if (!step) return tell(`nothing to ${word}`);
  const { did, row } = step, place = did === "insert" ? placeOf(row) : step.place;
  if (place < 0) return tell("this edit is no longer in the table", true); // another page took it out
  try {
    if (did === "insert") await send("edits/remove", { row, place });
    else await send("edits/insert", { rows: [row], place });
  } catch (error) {
    from.push(step);
    throw error;
  }
  to.push(did === "insert" ? { did: "remove", row, place } : { did: "insert", row });
  saved(`${word}: ${row.action}, saved`);
}

/* The steps to undo and redo outlive a reload of the page, unless the edits have changed meanwhile. */
const STEPS = "contactimg-steps";
const edition = () => [state.run.run, state.run.edits.length, ...state.run.edits.slice(-1).map(keyOf)].join("\n");

function keepSteps() {
  const { undo, redo, number } = state;
  try { sessionStorage.setItem(STEPS, JSON.stringify({ edition: edition(), undo, redo, number })); } catch { /* storage is full or off */ }
}

function keptSteps() {
  try {
    const kept = JSON.parse(sessionStorage.getItem(STEPS));
    return kept && kept.edition === edition() ? kept : null;
  } catch { return null; }
}

const undo = () => attempt(stepBack(state.undo, state.redo, "undo"));
const redo = () => attempt(stepBack(state.redo, state.undo, "redo"));

function saved(text) {
  if (state.unsaved <= 0) tell(text);
  keepSteps();
  showRun();
  draw();
}

function exclude() {
  if (!state.selected.length) return tell("select a contact first", true);
  const chosen = state.selected;
  select([]);
  for (const { x, y } of chosen) attempt(addEdit({ action: "exclude", x_px: x, y_px: y }));
}

function merge() {
  if (state.selected.length < 2) return tell("select two contacts or more: Shift and click", true);
  const points = state.selected.map(({ x, y }) => `${x} ${y}`).join(";");
  select([]);
  attempt(addEdit({ action: "merge", points }));
}

function startSplit() {
  if (state.selected.length !== 1) return tell("select the contact to split first", true);
  setTool("split");
  tell("click the centres of the parts, then Enter; Enter alone splits along the long axis");
}

function finishDraft() {
  const draft = state.draft, points = ((draft && draft.points) || []).map(([x, y]) => `${short(x, 8)} ${short(y, 8)}`);
  if (state.tool === "split" && state.selected.length === 1) {
    if (points.length === 1) return tell("a split needs two centres or none", true);
    const { x, y } = state.selected[0];
    select([]);
    attempt(addEdit({ action: "split", x_px: x, y_px: y, points: points.join(";") }));
    setTool("select");
  } else if (draft && draft.action === "mask") {
    if (points.length < 3) return tell("a mask needs three corners or more", true);
    state.draft = null;
    attempt(addEdit({ action: "mask", points: points.join(";") }));
  }
  draw();
}

function accept() {
  const spot = state.hover;
  if (!spot || !spot.reason) return false;
  attempt(addEdit({ action: "add", x_px: spot.x, y_px: spot.y, radius_px: Math.max(spot.radius, 1) }));
  return true;
}

// ---- threshold

function showCurves() {
  const curves = state.curves, slider = byId("slider");
  slider.disabled = !curves;
  byId("use-threshold").disabled = !curves || !state.run.scene_file;
  byId("use-threshold").title = state.run.scene_file ? `writes method and threshold into ${state.run.scene_file}` : "the run was made without a scene.toml";
  byId("method").textContent = state.run.method === "threshold" ? `method threshold, ${short(state.run.threshold ?? 0.5, 3)}` : "method disk: acts on the method threshold only";
  if (!curves) { byId("at-threshold").textContent = "counting ..."; return; }
  slider.min = 0; slider.max = curves.thresholds.length - 1; slider.step = 1;
  const k = Number(slider.value), unit = curves.unit === "m2" ? "mm²" : "px²", factor = curves.unit === "m2" ? 1e6 : 1;
  byId("at-threshold").textContent = `${short(curves.thresholds[k], 3)}: ${curves.counts[k]} contacts, ${short(curves.areas[k] * factor, 4)} ${unit}; calibrate: ${short(curves.scanned_areas[k] * factor, 4)} ${unit}`;
  byId("plateau-text").textContent = curves.plateau ? `Plateau of this frame: ${curves.plateau[0]} to ${curves.plateau[2]}, slowest fall at ${curves.plateau[1]}.` : "This frame has no plateau.";
  drawCurve(curves, k);
}

function drawCurve(curves, k) {
  const canvas = byId("curve"), ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const pen = canvas.getContext("2d"), t = curves.thresholds, left = 4, bottom = height - 16;
  pen.scale(ratio, ratio);
  const px = (value) => left + ((value - t[0]) / (t[t.length - 1] - t[0])) * (width - 8);
  const top = Math.max(...curves.areas, ...curves.scanned_areas) * 1.05 || 1, most = Math.max(...curves.counts) * 1.05 || 1;
  if (curves.plateau) { pen.fillStyle = "#e3effa"; pen.fillRect(px(curves.plateau[0]), 0, px(curves.plateau[2]) - px(curves.plateau[0]), bottom); }
  const line = (values, full, colour, dashes) => {
    pen.beginPath(); pen.setLineDash(dashes); pen.strokeStyle = colour; pen.lineWidth = 1.6;
    values.forEach((value, j) => pen.lineTo(px(t[j]), bottom - (value / full) * (bottom - 4)));
    pen.stroke(); pen.setLineDash([]);
  };
  line(curves.counts, most, "#5d6b7a", [2, 3]);
  line(curves.scanned_areas, top, "#e69f00", [7, 3]);
  line(curves.areas, top, "#0072b2", []);
  pen.strokeStyle = "#1c2733"; pen.lineWidth = 1;
  pen.beginPath(); pen.moveTo(px(t[k]), 0); pen.lineTo(px(t[k]), bottom); pen.moveTo(left, bottom); pen.lineTo(width - 4, bottom); pen.stroke();
  pen.fillStyle = "#5d6b7a"; pen.font = "11px system-ui, sans-serif";
  pen.fillText(short(t[0], 3), left, height - 4);
  pen.textAlign = "right"; pen.fillText(short(t[t.length - 1], 3), width - 4, height - 4);
  pen.textAlign = "center";
  const names = [["— area", "#0072b2", 0.26], ["– – calibrate", "#b87d00", 0.5], ["··· count", "#5d6b7a", 0.76]];
  for (const [name, colour, at] of names) { pen.fillStyle = colour; pen.fillText(name, at * width, height - 4); }
}

async function loadCurves() {
  const number = state.number;
  state.curves = null;
  showCurves();
  const curves = await ask(`frames/${number}/curves.json`);
  if (number !== state.number) return;
  const wanted = state.run.threshold ?? 0.5, nearest = (best, value, k) => (Math.abs(value - wanted) < Math.abs(curves.thresholds[best] - wanted) ? k : best);
  byId("slider").max = curves.thresholds.length - 1;
  byId("slider").value = curves.thresholds.reduce(nearest, 0);
  state.curves = curves;
  showCurves();
}

async function loadLight() {
  state.above = state.light = null;
  if (!byId("show-light").checked) return draw();
  const number = state.number, picture = await bitmapOf(`frames/${number}/light.png`);
  if (number !== state.number) return;
  const canvas = document.createElement("canvas");
  canvas.width = picture.width; canvas.height = picture.height;
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.drawImage(picture, 0, 0);
  state.light = pen.getImageData(0, 0, picture.width, picture.height);
  markAbove();
}

function markAbove() {
  const light = state.light;
  if (!light || !state.curves) return draw();
  const least = (state.curves.thresholds[Number(byId("slider").value)] / state.run.light_top) * 255;
  const canvas = state.above || document.createElement("canvas");
  canvas.width = light.width; canvas.height = light.height;
  const pen = canvas.getContext("2d"), data = pen.createImageData(light.width, light.height), out = new Uint32Array(data.data.buffer);
  const [r, g, b] = ABOVE_COLOUR, tint = (120 << 24) | (b << 16) | (g << 8) | r, from = light.data;
  for (let k = 0; k < out.length; k++) if (from[4 * k] > least) out[k] = tint;
  pen.putImageData(data, 0, 0);
  state.above = canvas;
  draw();
}

async function useThreshold() {
  const threshold = state.curves.thresholds[Number(byId("slider").value)];
  const question = `Write method = "threshold" and threshold = ${threshold} into ${state.run.scene_file}? Comments and all other keys stay.`;
  if (!window.confirm(question)) return;
  takeRun(await ask("threshold", { threshold }));
  tell(`saved: threshold ${threshold} in ${state.run.scene_file}; measure again to see it`);
  showRun();
}

// ---- frames

async function bitmapOf(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error((await answer.json()).error);
  return createImageBitmap(await answer.blob());
}

async function openFrame(number, keepView = true) {
  if (number < 0 || number >= state.run.frames.length) return;
  const name = state.run.frames[number].name;
  Object.assign(state, { number, draft: null, hover: null, light: null, above: null, curves: null });
  tell(`opening ${name} ...`);
  showRun();
  const before = state.size.join(), picture = bitmapOf(`frames/${number}/image.png`).catch((error) => { tell(error.message, true); return null; });
  const [image, data] = await Promise.all([picture, ask(`frames/${number}/contacts.json`)]);
  if (number !== state.number) return;
  keepSteps();
  state.image = image;
  state.size = image ? [image.width, image.height] : state.size;
  takeContacts(data);
  if (keepView && before === state.size.join()) draw(); else fit();
  select([]);
  showLegend();
  if (image) tell((data.row && data.row.message) || name);
  attempt(loadLight());
  scheduleCurves();
}

let curvesTimer = 0;
function scheduleCurves() {
  window.clearTimeout(curvesTimer);
  curvesTimer = window.setTimeout(() => attempt(loadCurves()), 400);
}

function takeRun(record) {
  state.run = { ...state.run, ...record };
}

function showRun() {
  const { run, number } = state, pending = run.frames.filter((frame) => frame.pending).length;
  byId("run").textContent = run.run;
  document.title = `${run.frames[number].name} · contactimg review`;
  byId("frame-count").textContent = `${number + 1} of ${run.frames.length}`;
  showFrames(run, number);
  showEdits();
  byId("measure").classList.toggle("wanted", pending > 0 || run.scene_changed);
  byId("measure").disabled = run.job.running;
  byId("undo").disabled = !state.undo.length;
  byId("redo").disabled = !state.redo.length;
  const source = run.measured ? "Measured again on this page; nothing of it is written." : "The tables of the run.";
  const next = pending ? ` The edits of ${pending} frame${pending > 1 ? "s" : ""} are not in them yet.` : "";
  const changed = run.changed.length ? ` ${run.changed.join(" and ")} was changed after the run.` : "";
  const other = run.scene_changed ? " The threshold chosen is not in them yet." : "";
  byId("source").textContent = `${source}${changed}${next}${other} To write tables with the edits: ${run.command}`;
}

/* Only what changed is touched: a list of many frames keeps its place and its focus. */
function showFrames(run, number) {
  const list = byId("frame-list");
  while (list.children.length < run.frames.length) {
    const item = document.createElement("li"), button = document.createElement("button"), small = document.createElement("small"), k = list.children.length;
    button.append(document.createElement("span"), small);
    button.addEventListener("click", () => attempt(openFrame(k)));
    item.append(button);
    list.append(item);
  }
  run.frames.forEach((frame, k) => {
    const button = list.children[k].firstChild, [title, small] = button.children;
    const edits = frame.n_edits ? ` · ${frame.n_edits} edit${frame.n_edits > 1 ? "s" : ""}${frame.pending ? " *" : ""}` : frame.pending ? " · edits *" : "";
    title.textContent = frame.name;
    small.textContent = `${frame.status} · ${frame.n_contacts ?? "no"} contacts${frame.load_N === null ? "" : ` · ${short(frame.load_N * 1e3, 3)} mN`}${edits}`;
    small.className = frame.status === "ok" ? "" : "bad";
    button.setAttribute("aria-pressed", k === number);
  });
  list.children[number].scrollIntoView({ block: "nearest" });
}

function showEdits() {
  const edits = editsOfFrame();
  byId("edit-count").textContent = `${edits.length} on this frame`;
  byId("edit-list").replaceChildren(...edits.map(({ row, place }) => {
    const item = document.createElement("li"), text = document.createElement("span"), more = document.createElement("small"), button = document.createElement("button");
    const at = row.x_px === null ? `${pointsOf(row.points).length} points` : `${short(row.x_px, 4)}, ${short(row.y_px, 4)}`;
    text.textContent = `${row.action} (${at})${row.frame === "*" ? ", all frames" : ""} `;
    more.textContent = [row.author, row.reason].filter(Boolean).join(": ");
    button.textContent = "×";
    button.title = "Take this edit out";
    button.setAttribute("aria-label", `Take out ${text.textContent}`);
    button.addEventListener("click", () => attempt(removeEdit(row, place)));
    text.append(more);
    item.append(text, button);
    return item;
  }));
}

async function measureAgain() {
  takeRun(await ask("measure", {}));
  showRun();
  await followJob();
}

async function followJob() {
  let job = await ask("job.json");
  while (job.running) {
    tell(`measuring: ${job.done} of ${job.total} frames`);
    await new Promise((wake) => setTimeout(wake, 250));
    job = await ask("job.json");
  }
  takeRun(await ask("run.json"));
  showRun();
  if (job.error) throw new Error(`measure: ${job.error}`);
  const data = await ask(`frames/${state.number}/contacts.json`);
  takeContacts(data);
  select([]);
  showLegend();
  scheduleCurves();
  tell(`measured again: ${state.contacts.length} contacts${data.row && data.row.message ? `; ${data.row.message}` : ""}`);
}

function showLegend() {
  const counts = new Map(state.run.kinds.map((kind) => [kind, 0]));
  for (const contact of state.contacts) counts.set(contact.kind, counts.get(contact.kind) + 1);
  const items = state.run.kinds.map((kind) => legendItem(kind, counts.get(kind), kind.flag_names.join(", ") || "no flag", !state.hidden.has(kind.name), (on) => {
    state.hidden[on ? "delete" : "add"](kind.name);
  }));
  items.push(legendItem(state.run.rejected, state.rejected.length, "candidates that are no contacts; the reason shows under the mouse", state.show.rejected, (on) => { state.show.rejected = on; }, true));
  byId("legend").replaceChildren(...items);
}

function legendItem(kind, count, title, on, change, isCross = false) {
  const label = document.createElement("label"), box = document.createElement("input"), text = document.createElement("span");
  const picture = document.createElementNS("http://www.w3.org/2000/svg", "svg"), line = document.createElementNS(picture.namespaceURI, "path");
  line.setAttribute("d", isCross ? "M9 2L17 10M9 10L17 2" : "M1 6H25");
  line.setAttribute("stroke", kind.colour);
  line.setAttribute("stroke-width", "2.2");
  line.setAttribute("stroke-dasharray", kind.dashes.join(" "));
  picture.append(line);
  box.type = "checkbox"; box.checked = on;
  box.addEventListener("change", () => { change(box.checked); layerOf = null; draw(); });
  text.textContent = `${kind.name} (${count})`;
  label.title = title;
  label.append(box, picture, text);
  return label;
}

// ---- mouse and keys

const TOOLS = [
  ["select", "Select", "V", "click a contact; drag moves the picture"], ["add", "Add", "A", "drag from the centre of a contact to its rim"],
  ["exclude", "Exclude", "E", "the selected contact is none"], ["split", "Split", "S", "the selected contact is two or more"],
  ["merge", "Merge", "G", "the selected contacts are one"], ["mask", "Mask", "K", "click corners, then Enter"],
];
const KEYS = [
  ["V, A, K", "tools: select, add, mask"], ["E or Delete", "exclude the selected contacts"], ["S", "split the selected contact: click centres, Enter"],
  ["Shift+click, G", "select several contacts, merge them"], ["A on a rejected candidate", "accept it as a contact"], ["Ctrl+Z, Ctrl+Y", "undo, redo"],
  ["M", "measure again"], ["N, P", "next, previous frame"], ["Tab, Shift+Tab", "next, previous contact (in the picture)"], ["wheel, + and -", "zoom"],
  ["drag, arrows", "move; in every tool: middle button or Space and drag"], ["F, 1", "whole frame; one pixel a pixel of the screen"], ["T, O, R", "show pixels above the threshold, edits, rejected candidates"], ["Esc", "drop what was begun, or the selection"],
];

function setTool(tool) {
  state.tool = tool;
  state.draft = null;
  for (const button of byId("tools").children) button.setAttribute("aria-pressed", button.dataset.tool === tool);
  draw();
}

function useTool(tool) {
  if (tool === "exclude") return exclude();
  if (tool === "merge") return merge();
  if (tool === "split") return startSplit();
  setTool(tool);
  tell(TOOLS.find(([name]) => name === tool)[3]);
}

const placeOfMouse = (event) => { const box = view.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
let spaceDown = false;

function mouseDown(event) {
  const at = placeOfMouse(event), [x, y] = toImage(...at);
  view.focus({ preventScroll: true });
  view.setPointerCapture(event.pointerId);
  event.preventDefault();
  const moves = event.button === 1 || spaceDown || state.tool === "select";
  state.drag = { at, from: { ...state.view }, moved: false, moves, button: event.button };
  if (!moves && state.tool === "add" && event.button === 0) state.draft = { action: "add", x, y, radius: 0 };
}

function mouseMove(event) {
  const at = placeOfMouse(event), [x, y] = toImage(...at), { drag, draft } = state;
  if (drag) drag.moved = drag.moved || Math.hypot(at[0] - drag.at[0], at[1] - drag.at[1]) > 3;
  if (drag && drag.moves && drag.moved) {
    state.view.x = drag.from.x - (at[0] - drag.at[0]) / drag.from.scale;
    state.view.y = drag.from.y - (at[1] - drag.at[1]) / drag.from.scale;
    draw();
  } else if (draft && draft.action === "add" && drag) {
    draft.radius = Math.hypot(x - draft.x, y - draft.y);
    draw();
  } else if (draft && draft.points) {
    draft.cursor = [x, y];
    draw();
  }
  if (!drag) showTip(at, x, y);
}

function showPlace(x, y) {
  const [columns, rows] = state.size, inside = x > -0.5 && y > -0.5 && x < columns - 0.5 && y < rows - 0.5;
  const place = inside ? `x ${x.toFixed(1)}, y ${y.toFixed(1)} px · ` : "";
  byId("place").textContent = `${place}${short(state.view.scale * 100, 3)} %`;
}

function showTip(at, x, y) {
  showPlace(x, y);
  const contact = contactAt(x, y), spot = rejectedAt(x, y);
  state.hover = spot || contact;
  const tip = byId("tip"), text = spot ? `rejected: ${spot.reason}` : contact ? `${contact.label}: ${flagsOf(state.data.contacts.flags[contact.row]).join(", ") || contact.kind.name}` : "";
  tip.hidden = !text;
  tip.textContent = text;
  tip.style.left = `${Math.min(at[0] + 14, view.clientWidth - 160)}px`;
  tip.style.top = `${at[1] + 14}px`;
}

function mouseUp(event) {
  const { drag, draft } = state, [x, y] = toImage(...placeOfMouse(event));
  state.drag = null;
  if (!drag || drag.button > 1) return;
  if (draft && draft.action === "add") {
    state.draft = null;
    const radius = Math.hypot(x - draft.x, y - draft.y);
    if (drag.moved && radius >= 0.5) attempt(addEdit({ action: "add", x_px: Number(short(draft.x, 8)), y_px: Number(short(draft.y, 8)), radius_px: Number(short(radius, 6)) }));
    else tell("drag from the centre of the contact to its rim", true);
    return draw();
  }
  if (drag.moves && (drag.moved || drag.button === 1 || state.tool !== "select")) return;
  if (state.tool === "mask" || state.tool === "split") {
    state.draft = state.draft || { action: state.tool, points: [] };
    state.draft.points.push([x, y]);
    return draw();
  }
  const contact = contactAt(x, y);
  if (!event.shiftKey) return select(contact ? [contact] : []);
  if (contact) select(state.selected.includes(contact) ? state.selected.filter((one) => one !== contact) : [...state.selected, contact]);
}

function stepContact(step) {
  if (!state.contacts.length) return;
  const last = state.selected[state.selected.length - 1];
  const row = last ? (last.row + step + state.contacts.length) % state.contacts.length : 0;
  const contact = state.contacts[row], [sx, sy] = toScreen(contact.x, contact.y);
  if (sx < 20 || sy < 20 || sx > view.clientWidth - 20 || sy > view.clientHeight - 20) {
    state.view.x = contact.x - view.clientWidth / 2 / state.view.scale;
    state.view.y = contact.y - view.clientHeight / 2 / state.view.scale;
  }
  select([contact]);
}

function pan(dx, dy) {
  state.view.x += dx / state.view.scale;
  state.view.y += dy / state.view.scale;
  draw();
}

const toggle = (change) => () => { change(); layerOf = null; showLegend(); draw(); };
const middle = () => [view.clientWidth / 2, view.clientHeight / 2];
const ACTIONS = {
  v: () => useTool("select"), a: () => accept() || useTool("add"), k: () => useTool("mask"), s: startSplit, g: merge, e: exclude, Delete: exclude,
  m: () => attempt(measureAgain()), n: () => attempt(openFrame(state.number + 1)), p: () => attempt(openFrame(state.number - 1)),
  f: fit, 1: () => zoom(1 / state.view.scale, ...middle()), "+": () => zoom(1.25, ...middle()), "=": () => zoom(1.25, ...middle()), "-": () => zoom(0.8, ...middle()),
  t: () => byId("show-light").click(), o: toggle(() => { state.show.edits = !state.show.edits; }), r: toggle(() => { state.show.rejected = !state.show.rejected; }),
  ArrowLeft: () => pan(-60, 0), ArrowRight: () => pan(60, 0), ArrowUp: () => pan(0, -60), ArrowDown: () => pan(0, 60),
  Enter: finishDraft, Escape: () => { if (state.draft || state.tool !== "select") setTool("select"); else select([]); }, "?": () => byId("help").showModal(),
  Backspace: () => { if (state.draft && state.draft.points) state.draft.points.pop(); draw(); },
};

function keyDown(event) {
  const inField = event.target.closest("input:not([type=checkbox]):not([type=range]), dialog");
  if (inField) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.ctrlKey || event.metaKey) {
    const action = key === "z" ? (event.shiftKey ? redo : undo) : key === "y" ? redo : null;
    if (action) { event.preventDefault(); action(); }
    return;
  }
  const onView = document.activeElement === view || document.activeElement === document.body;
  if (key === " " && onView) { spaceDown = true; event.preventDefault(); return; }
  if (key === "Tab") {
    if (document.activeElement !== view || !state.contacts.length) return;
    event.preventDefault();
    return stepContact(event.shiftKey ? -1 : 1);
  }
  const isControl = event.target.closest("button, input, a"), ofControl = ["Enter", " ", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];
  if (event.altKey || !ACTIONS[key] || (isControl && ofControl.includes(key))) return;
  event.preventDefault();
  ACTIONS[key]();
}

// ---- start

function makeTools() {
  byId("tools").replaceChildren(...TOOLS.map(([tool, name, key, title]) => {
    const button = document.createElement("button");
    button.textContent = name;
    button.title = `${title} (${key})`;
    button.dataset.tool = tool;
    button.addEventListener("click", () => { useTool(tool); view.focus(); });
    return button;
  }));
  fillTable(byId("keys"), KEYS);
}

function listen() {
  view.addEventListener("pointerdown", mouseDown);
  view.addEventListener("pointermove", mouseMove);
  view.addEventListener("pointerup", mouseUp);
  view.addEventListener("pointerleave", () => { byId("tip").hidden = true; state.hover = null; });
  view.addEventListener("dblclick", finishDraft);
  view.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.0015), ...placeOfMouse(event)); }, { passive: false });
  window.addEventListener("keydown", keyDown);
  window.addEventListener("keyup", (event) => { if (event.key === " ") spaceDown = false; });
  window.addEventListener("beforeunload", (event) => { if (state.unsaved > 0) event.preventDefault(); });
  new ResizeObserver(() => { keepMiddle(); if (state.curves) showCurves(); }).observe(view);
  byId("undo").addEventListener("click", undo);
  byId("redo").addEventListener("click", redo);
  byId("measure").addEventListener("click", () => attempt(measureAgain()));
  byId("use-threshold").addEventListener("click", () => attempt(useThreshold()));
  byId("slider").addEventListener("input", () => { showCurves(); if (byId("show-light").checked) markAbove(); });
  byId("show-light").addEventListener("change", () => attempt(loadLight()));
  byId("help-button").addEventListener("click", () => byId("help").showModal());
  const author = byId("author");
  try { author.value = localStorage.getItem("contactimg-author") || ""; } catch { /* storage is switched off */ }
  author.addEventListener("change", () => { try { localStorage.setItem("contactimg-author", author.value); } catch { /* the same */ } });
}

async function begin() {
  makeTools();
  listen();
  takeRun(await ask("run.json"));
  setTool("select");
  const first = state.run.frames.findIndex((frame) => frame.status !== "ok");
  const { undo: earlier = [], redo: taken = [], number = Math.max(first, 0) } = keptSteps() || {};
  Object.assign(state, { undo: earlier, redo: taken });
  await openFrame(number, false);
  if (state.run.job.running) await followJob();
}

window.review = { state, draw: drawNow, toScreen, redrawLayer: () => { layerOf = null; drawNow(); } };
attempt(begin());
