// The chooser, the figures of the run in focus, its fleet, events, and the settings of all runs.
import { clock, duration, element, fixed, isNumber, short, swatch, whole } from "./texts.js";
import { colourOf, letterOf } from "./plots.js";

const LATE_S = 1.5;

export function drawChoices(place, title, entries, shown, choose) {
  title.textContent = `Runs (${shown.length} of ${entries.length} shown)`;
  // A list that is being used is not replaced under the pointer.
  const signature = JSON.stringify([entries, shown]);
  if (place.dataset.signature === signature) return;
  place.dataset.signature = signature;
  place.replaceChildren(
    ...entries.map((entry) => {
      const box = element("input", { type: "checkbox" });
      box.checked = shown.includes(entry.id);
      box.addEventListener("change", () => choose(entry.id, box.checked));
      const steps = isNumber(entry.env_steps) && isNumber(entry.total_steps) ? `${short(entry.env_steps)} of ${short(entry.total_steps)} steps` : null;
      const about = [entry.state, entry.task && `${entry.learner} on ${entry.task}`, isNumber(entry.seed) ? `seed ${entry.seed}` : null, steps, isNumber(entry.return) ? `return ${fixed(entry.return, 1)}` : null];
      return element("label", {}, box, element("span", { class: "name" }, entry.id), element("span", { class: "about" }, about.filter(Boolean).join(" · ")));
    }),
  );
}

export function drawLegend(place, runs, focus, setFocus) {
  const signature = JSON.stringify([runs.map((run) => run.id), focus]);
  if (place.dataset.signature === signature) return;
  place.dataset.signature = signature;
  place.hidden = runs.length < 2;
  place.replaceChildren(
    ...runs.map((run, number) => {
      const button = element("button", { type: "button", "aria-pressed": String(run.id === focus), title: "Show its figures, timeline, fleet and events" }, swatch(colourOf(number)), `${letterOf(number)} · ${run.id}`);
      button.addEventListener("click", () => setFocus(run.id));
      return element("li", {}, button);
    }),
  );
}

function figure(name, value, note) {
  return [element("dt", {}, name), element("dd", {}, value, note ? element("small", {}, ` ${note}`) : null)];
}

export function drawFigures(place, state, evaluation) {
  const summary = state.summary;
  const final = summary && isNumber(summary.eval_return_mean);
  const evaluated = final ? [fixed(summary.eval_return_mean, 1), `± ${fixed(summary.eval_return_std, 1)}, final, ${whole(summary.eval_episodes)} episodes`]
    : evaluation ? [fixed(evaluation.return_mean, 1), `± ${fixed(evaluation.return_std, 1)}, update ${whole(evaluation.version)}`] : null;
  const rows = [
    ["phase", state.phase ?? "-"],
    ["update", whole(state.version), isNumber(state.updates) ? `of ${whole(state.updates)}` : ""],
    ["environment steps", short(state.env_steps), isNumber(state.total_steps) ? `of ${short(state.total_steps)}` : ""],
    isNumber(state.steps_per_s) ? ["speed", whole(state.steps_per_s), "steps/s"] : null,
    state.phase === "finished" ? (summary && isNumber(summary.wall_s) ? ["took", duration(summary.wall_s), "in all"] : null) : ["time left", duration(state.remaining_s), "at this speed"],
    ["return, training", fixed(state.return, 1), "newest episodes"],
    evaluated ? ["return, evaluation", ...evaluated] : null,
    isNumber(state.step_reward) ? ["reward", fixed(state.step_reward, 2), "per step"] : null,
    isNumber(state.centres) && (state.capacity || state.centres) ? ["expansion", whole(state.centres), state.capacity ? `of ${whole(state.capacity)} centres` : "centres"] : null,
    ["staleness", short(state.staleness ?? 0), "versions"],
    state.diverged ? ["diverged", whole(state.diverged), "simulations"] : null,
  ];
  place.replaceChildren(...rows.filter(Boolean).map(([name, value, note]) => element("div", {}, ...figure(name, value, note))));
}

const FLEET = [
  ["slot", "right"], ["actor", ""], ["host", ""], ["state", ""], ["for", "right"], ["engine", ""], ["policy", "right"], ["policy age", "right"],
  ["steps/s", "right"], ["heard", "right"], ["accepted", "right"], ["not used", "right"],
];

export function drawFleet(table, note, rollouts, state) {
  rollouts.textContent = "";
  if (state.actors && (state.actors.length || state.vacancies?.length)) {
    note.textContent = `${state.actors.length} of ${state.slots} slots have an actor` + (state.evaluators ? `; ${state.evaluators} evaluators` : "") + (state.waits ? `. Now: ${state.waits}` : "");
    const rows = [
      ...state.actors.map((actor) => ({ slot: actor.slot, cells: actorCells(actor) })),
      ...(state.vacancies ?? []).map((free) => ({ slot: free.slot, cells: vacancyCells(free) })),
    ].sort((one, other) => one.slot - other.slot);
    fill(table, FLEET, rows.map((row) => row.cells));
    const totals = state.totals;
    rollouts.textContent = `Rollouts since the learner's start: ${whole(totals.accepted)} accepted, ${whole(totals.refused)} refused, ${whole(totals.busy)} told to come later, ${whole(totals.repeated)} repeated. Actors: ${whole(totals.joined)} joined, ${whole(totals.lost)} lost.` + (state.last_refusal ? ` Last refusal: ${state.last_refusal}` : "");
    return;
  }
  const slots = state.logged_slots ?? [];
  const over = state.phase === "finished";
  note.textContent = slots.length
    ? (over ? "The run is over; these actors took part in it last." : "The learner cannot be asked from here; this is what its log says about whose rollouts it used last.")
    : over ? "The run is over." : "No actor yet.";
  const headings = [["slot", "right"], ["actor", ""], ["policy", "right"], ["last used", ""]];
  const used = (slot) => (over || !isNumber(state.now_s) ? `at ${clock(slot.t_s)}` : `${duration(Math.max(0, state.now_s - slot.t_s))} ago`);
  fill(table, slots.length ? headings : [], slots.map((slot) => [String(slot.slot), slot.incarnation, whole(slot.version), used(slot)]));
}

function actorCells(actor) {
  const compiling = actor.state === "compiling";
  const late = actor.heard_s > LATE_S;
  return [
    String(actor.slot), actor.actor, actor.host, actor.state, duration(actor.state_s), actor.engine,
    compiling ? "-" : whole(actor.version) + (actor.behind ? ` (-${actor.behind})` : ""), compiling ? "-" : duration(actor.policy_age_s), whole(actor.steps_per_s),
    { text: duration(actor.heard_s) + (late ? " silent" : " ago"), class: late ? "late" : "" }, whole(actor.accepted), whole(actor.refused),
  ];
}

function vacancyCells(free) {
  const state = { text: free.lost ? "lost its actor" : "no actor yet", class: free.lost ? "lost" : "" };
  return [String(free.slot), "-", "-", state, duration(free.for_s), ...new Array(FLEET.length - 5).fill("-")];
}

function fill(table, headings, rows) {
  const head = element("tr", {}, ...headings.map(([name, side]) => element("th", { scope: "col", class: side }, name)));
  const body = rows.map((cells) =>
    element("tr", {}, ...cells.map((cell, number) => {
      const side = headings[number][1];
      return typeof cell === "object" ? element("td", { class: `${side} ${cell.class}` }, cell.text) : element("td", { class: side }, cell);
    })),
  );
  table.replaceChildren(element("thead", {}, head), element("tbody", {}, ...body));
}

export function drawEvents(list, events) {
  list.replaceChildren(
    ...[...events].reverse().map((event) => {
      const when = element("time", { datetime: new Date(event.t_s * 1000).toISOString(), title: new Date(event.t_s * 1000).toLocaleString("en-GB") }, clock(event.t_s));
      const level = ["warning", "error"].includes(event.level) ? event.level : "info";
      return element("li", { class: level }, when, element("span", {}, level === "info" ? event.text : `${level}: ${event.text}`));
    }),
  );
  if (!events.length) list.replaceChildren(element("li", {}, element("time", {}, "-"), element("span", {}, "nothing yet")));
}

export function drawSettings(section, table, runs) {
  const known = runs.filter((run) => Object.keys(run.state.settings ?? {}).length);
  section.hidden = known.length === 0;
  const names = [...new Set(known.flatMap((run) => Object.keys(run.state.settings)))];
  const headings = [["setting", ""], ...known.map((run) => [runs.length > 1 ? letterOf(runs.indexOf(run)) : "value", ""])];
  const rows = names.map((name) => {
    const values = known.map((run) => run.state.settings[name] ?? "-");
    const differs = new Set(values).size > 1 ? "differs" : "";
    return [name, ...values.map((value) => ({ text: value, class: differs }))];
  });
  fill(table, headings, rows);
}
