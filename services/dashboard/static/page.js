// The page: keeps what the stream sends, and draws it a few times a second at most.
import { AXES, PHASES, PLOTS, Plot, colourOf, letterOf, places, shares, stacked } from "./plots.js";
import { drawChoices, drawEvents, drawFigures, drawFleet, drawLegend, drawSettings } from "./tables.js";
import { element, isNumber, seconds } from "./texts.js";

const MOST_SHOWN = 12;
const KEPT_EVENTS = 200;
const DRAW_MS = 200;

const get = (id) => document.getElementById(id);
const runs = new Map(); // id -> {id, columns, evaluations, events, state}, in the order in which they are shown
let entries = [];
let shown = [];
let focus = "";
let source = null;
let due = null;
let settingsDrawn = "";

const plots = PLOTS.map((plot) => ({ ...plot, view: new Plot(plot) }));
const timelines = Object.values(PHASES).map((phase) => ({ ...phase, view: new Plot({ title: phase.title, unit: "seconds", what: phase.what, zero: true }) }));
get("plots").append(...plots.map((plot) => plot.view.card));
get("timeline-plots").append(...timelines.map((timeline) => timeline.view.card));

function chosen() {
  return new URLSearchParams(location.hash.slice(1)).getAll("run");
}

function connect() {
  if (source) source.close();
  const query = new URLSearchParams(chosen().map((id) => ["run", id]));
  source = new EventSource(`stream?${query}`);
  source.addEventListener("open", () => connection(true));
  source.addEventListener("error", () => connection(false));
  source.addEventListener("runs", (event) => {
    const told = JSON.parse(event.data);
    entries = told.runs;
    shown = told.shown;
    for (const id of runs.keys()) if (!shown.includes(id)) runs.delete(id);
    if (!shown.includes(focus)) focus = shown[0] ?? "";
    draw();
  });
  source.addEventListener("run", (event) => {
    take(JSON.parse(event.data));
    draw();
  });
}

function connection(open) {
  const place = get("connection");
  place.textContent = open ? "live" : "no connection to the dashboard; trying again";
  place.classList.toggle("lost", !open);
}

function take(added) {
  if (added.fresh || !runs.has(added.id)) runs.set(added.id, { id: added.id, columns: {}, evaluations: [], events: [], state: {} });
  const run = runs.get(added.id);
  if (added.columns) {
    const length = added.start;
    for (const name of Object.keys(added.columns)) {
      const before = (run.columns[name] ?? []).slice(0, length);
      run.columns[name] = before.concat(added.columns[name]);
    }
    run.width = added.width;
  }
  if (added.evaluations) run.evaluations.push(...added.evaluations);
  if (added.events) run.events = run.events.concat(added.events).slice(-KEPT_EVENTS);
  if (added.state) run.state = added.state;
}

function draw() {
  due ??= setTimeout(() => {
    due = null;
    drawNow();
  }, DRAW_MS);
}

function drawNow() {
  drawChoices(get("choices"), get("chooser-title"), entries, shown, choose);
  const list = shown.filter((id) => runs.has(id)).map((id) => runs.get(id));
  drawLegend(get("legend"), list, focus, setFocus);
  drawCurves(list);
  const run = runs.get(focus);
  get("run").hidden = !run;
  for (const id of ["timeline", "fleet", "happened"]) get(id).hidden = !run;
  if (run) drawFocus(run, list.indexOf(run), list.length);
  if (!run) drawNothing();
  const settings = JSON.stringify(list.map((one) => one.state.settings));
  if (settings !== settingsDrawn) drawSettings(get("compared"), get("settings"), list);
  settingsDrawn = settings;
}

function drawNothing() {
  get("run").hidden = false;
  get("run-title").textContent = "No run yet";
  notice("notice", "waiting for the learner: there is no run here yet");
  get("figures").replaceChildren();
}

function drawCurves(list) {
  const axis = get("axis").value;
  const [scale, label] = axisOf(axis, list);
  for (const plot of plots) {
    const lines = list.flatMap((run, number) =>
      plot.series.map((series) => {
        const points = series.evaluations ? run.evaluations : run.columns;
        const y = series.evaluations ? run.evaluations.map((one) => one.return_mean) : run.columns[series.column] ?? [];
        const x = places(points, axis, scale);
        const name = list.length > 1 ? `${letterOf(number)} ${plot.series.length > 1 ? series.label : ""}` : series.label;
        return { ...inOrder(x.slice(0, y.length), y), label: name, colour: colourOf(number), kind: series.kind };
      }),
    );
    plot.view.draw(lines, label);
  }
}

// Evaluations come in any order, and two of them may be of one version; a plot goes from left to right.
function inOrder(x, y) {
  if (x.every((value, row) => row === 0 || value > x[row - 1])) return { x, y };
  const rows = [...new Map(x.map((value, row) => [value, y[row]]))].filter(([value]) => isNumber(value));
  rows.sort((one, other) => one[0] - other[0]);
  return { x: rows.map((row) => row[0]), y: rows.map((row) => row[1]) };
}

function axisOf(axis, list) {
  if (axis !== "hours") return [1, AXES[axis]];
  const longest = Math.max(0, ...list.map((run) => run.columns.hours?.at(-1) ?? 0));
  return longest < 2 ? [60, "minutes since the start"] : [1, AXES.hours];
}

function drawFocus(run, number, count) {
  const { state } = run;
  const what = state.task ? `${state.learner} on ${state.task}` : "";
  get("run-title").textContent = [count > 1 ? letterOf(number) : null, what, isNumber(state.seed) ? `seed ${state.seed}` : null, run.id].filter(Boolean).join(" · ");
  document.title = what ? `${what} · ResKPN` : "ResKPN";
  notice("notice", [state.notice, state.since].filter(Boolean).join(". "));
  notice("problem", state.problem ?? "");
  const done = isNumber(state.total_steps) && state.total_steps > 0 ? (100 * (state.env_steps ?? 0)) / state.total_steps : 0;
  get("bar-done").style.width = `${Math.min(100, done)}%`;
  get("bar").setAttribute("aria-valuenow", String(Math.round(done)));
  drawFigures(get("figures"), state, run.evaluations.at(-1));
  for (const of of document.querySelectorAll("[data-of]")) of.textContent = count > 1 ? `of ${letterOf(number)} · ${run.id}` : "";
  drawTimeline(run);
  drawFleet(get("actors"), get("fleet-note"), get("rollouts"), state);
  drawEvents(get("events"), run.events);
}

function drawTimeline(run) {
  const axis = get("axis").value;
  const [scale, label] = axisOf(axis, [run]);
  const x = places(run.columns, axis, scale);
  const bars = Object.values(PHASES).map((phase) => shares(run.columns, phase)).filter(Boolean);
  get("timeline-bars").replaceChildren(...(bars.length ? bars : [element("p", { class: "hint" }, "Known after the first update.")]));
  get("timeline-bars").className = "bars";
  for (const timeline of timelines) timeline.view.draw(stacked(run.columns, timeline.parts, x), label, seconds);
}

function notice(id, told) {
  get(id).hidden = !told;
  if (get(id).textContent !== told) get(id).textContent = told;
}

function setFocus(id) {
  focus = id;
  draw();
}

function choose(id, wanted) {
  const now = wanted ? [...shown, id].slice(-MOST_SHOWN) : shown.filter((other) => other !== id);
  location.hash = new URLSearchParams(now.map((one) => ["run", one])).toString();
}

addEventListener("hashchange", connect);
get("axis").addEventListener("change", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const { view } of [...plots, ...timelines]) view.signature = "";
  draw();
});
connect();
