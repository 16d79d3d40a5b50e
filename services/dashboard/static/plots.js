// The plots: what each shows, and how uPlot draws it.
import { element, isNumber, seconds, short, swatch } from "./texts.js";

const LINES = ["#3b82f6", "#f97316", "#16a34a", "#a855f7", "#e11d48", "#0891b2", "#b45309", "#64748b", "#65a30d", "#db2777", "#4f46e5", "#0d9488"];
const HEIGHT = 220;
const NEWEST = 50;

export const colourOf = (number) => LINES[number % LINES.length];
export const letterOf = (number) => String.fromCharCode(65 + number);

export const AXES = {
  env_steps: "environment steps",
  version: "updates",
  hours: "hours since the start",
};

// `zero`: the y axis includes 0. `log`: it is logarithmic. `kind`: line, dash, or dot for single points.
export const PLOTS = [
  { key: "return", title: "Return", unit: "rewards per episode", what: "Sum of an episode's rewards: mean over the newest training episodes (at least 200), and of evaluations without exploration.",
    series: [{ column: "run/return", label: "training" }, { evaluations: true, label: "evaluation", kind: "dot" }] },
  { key: "reward", title: "Reward", unit: "per step", what: "Mean reward of a step in the newest batch; known before the first episode ends.",
    series: [{ column: "run/step_reward", label: "reward" }] },
  { key: "policy-loss", title: "Policy loss", unit: "negated objective", what: "Mean over the minibatches of an update. It hovers around 0 and is no measure of progress.",
    series: [{ column: "train/policy_loss", label: "policy loss" }] },
  { key: "value-loss", title: "Value loss", unit: "squared error, log scale", what: "Error of the critic for scaled returns; it grows when the policy finds new returns.", log: true,
    series: [{ column: "train/value_loss", label: "value loss" }] },
  { key: "explained", title: "Explained variance", unit: "share, 1 is perfect", what: "Share of the returns' variance that the critic predicts; 0 is no better than a constant.",
    series: [{ column: "train/explained_variance", label: "explained variance" }] },
  { key: "kl", title: "KL divergence", unit: "nats per update", what: "How far an update moved the policy: by the networks, and by the step of the kernel part.", zero: true,
    series: [{ column: "train/kl", label: "networks" }, { column: "rkhs/step_kl", label: "kernel step", kind: "dash" }] },
  { key: "std", title: "Standard deviation", unit: "of the policy's actions", what: "Exploration: the square root of the Gaussian's variance, mean over dimensions; it falls as the policy becomes sure.", zero: true,
    series: [{ column: "policy/std", label: "standard deviation" }] },
  { key: "variance", title: "Gradient variance", unit: "squared norm in the RKHS", what: "Of the functional gradient as it is taken, and of one transition's; measured where rkhs.variance_every is set.", zero: true,
    series: [{ column: "variance/gradient", label: "as taken" }, { column: "variance/one_transition", label: "one transition", kind: "dash" }] },
  { key: "centres", title: "Expansion size", unit: "centres in use", what: "Centres of the kernel expansion of h; it grows up to rkhs.capacity.", zero: true,
    series: [{ column: "rkhs/centres", label: "centres" }] },
  { key: "share", title: "Share of the kernel part", unit: "h² of h² + μ²", what: "How much of the mean action comes from the kernel function h instead of the residual layer μ: 0 none, 1 all.", zero: true,
    series: [{ column: "rkhs/share", label: "share" }] },
  { key: "staleness", title: "Staleness", unit: "policy versions", what: "Versions between the policy that acted and the one that is updated; always 0 in mode sync.", zero: true,
    series: [{ column: "staleness/mean", label: "mean" }, { column: "staleness/max", label: "max", kind: "dash" }] },
  { key: "speed", title: "Speed", unit: "environment steps per second", what: "Over the whole training so far, updates included.", zero: true,
    series: [{ column: "run/steps_per_s", label: "steps/s" }] },
];

export const PHASES = {
  learner: {
    key: "learner", title: "Learner", what: "Time between two updates.",
    parts: [
      { column: "seconds/wait", label: "waiting for rollouts", colour: "#94a3b8" },
      { column: "seconds/learner", label: "computing the update", colour: "#3b82f6" },
      { column: "seconds/publish", label: "publishing the policy", colour: "#f59e0b" },
      { column: "seconds/record", label: "digest, checkpoint, log", colour: "#10b981" },
    ],
  },
  actor: {
    key: "actor", title: "Slowest actor", what: "Time that one rollout took.",
    parts: [
      { column: "seconds/actor/physics", label: "physics", colour: "#8b5cf6" },
      { column: "seconds/actor/collect", label: "policy and bookkeeping", colour: "#ec4899" },
      { column: "seconds/actor/push", label: "sending", colour: "#f59e0b" },
    ],
  },
};

function style() {
  const read = getComputedStyle(document.documentElement);
  const value = (name) => read.getPropertyValue(name).trim();
  return { text: value("--soft"), grid: value("--grid") };
}

// Ticks that differ are written differently: digits follow from their distance.
export function ticks(values, step) {
  const size = Math.max(...values.map(Math.abs));
  if (!(size > 0)) return values.map(String);
  const [unit, suffix] = size >= 1e9 ? [1e9, "G"] : size >= 1e6 ? [1e6, "M"] : size >= 1e4 ? [1e3, "k"] : [1, ""];
  if (size < 1e-3) {
    const digits = Math.max(0, Math.ceil(Math.log10(size / step) - 0.01));
    return values.map((value) => (value === 0 ? "0" : value.toExponential(digits)));
  }
  let digits = 0;
  while (digits < 6 && Math.abs((step / unit) * 10 ** digits - Math.round((step / unit) * 10 ** digits)) > 1e-6) digits += 1;
  return values.map((value) => (value === 0 ? "0" : (value / unit).toFixed(digits) + suffix));
}

function rangeOf(zero) {
  return (_, low, high) => {
    if (!isNumber(low) || !isNumber(high)) return [0, 1];
    if (low === high) return low === 0 ? [0, 1] : zero ? [Math.min(0, low * 1.15), Math.max(0, low * 1.15)] : [low - Math.abs(low) * 0.1, low + Math.abs(low) * 0.1];
    const pad = (high - low) * 0.08;
    if (zero) return [Math.min(0, low - (low < 0 ? pad : 0)), Math.max(0, high + (high > 0 ? pad : 0))];
    return [low - pad, high + pad];
  };
}

// Powers of ten, six at most.
function powers(_, __, low, high) {
  const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
  const stride = Math.max(1, Math.ceil((last - first) / 5));
  const found = [];
  for (let power = first; power <= last; power += stride) found.push(Number(`1e${power}`));
  return found;
}

function axesOf(xLabel, log) {
  const { text, grid } = style();
  const font = '12px system-ui, "DejaVu Sans", sans-serif';
  const common = { stroke: text, font, labelFont: font, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1, size: 4 } };
  return [
    { ...common, label: xLabel, labelSize: 18, labelGap: 0, size: 30, space: 64, values: (_, found, __, ___, step) => ticks(found, step) },
    { ...common, size: 58, space: 34, ...(log ? { splits: powers, filter: (_, found) => found, values: (_, found) => found.map(short) } : { values: (_, found, __, ___, step) => ticks(found, step) }) },
  ];
}

// The x values of a run's rows or evaluations on the chosen axis.
export function places(source, axis, scale) {
  const values = Array.isArray(source) ? source.map((row) => row[axis]) : source[axis] ?? [];
  return scale === 1 ? values : values.map((value) => value * scale);
}

// One card with a plot. `draw` gives it series with their points; it shows itself only if there are any.
export class Plot {
  constructor({ title, unit, what, zero, log }) {
    this.zero = zero ?? false;
    this.log = log ?? false;
    this.legend = element("ul");
    this.place = element("div", { class: "canvas" });
    const heading = element("h3", {}, title, unit ? element("span", { class: "unit" }, ` · ${unit}`) : null);
    this.card = element("figure", { class: "plot", hidden: "" }, heading, element("p", { class: "what" }, what), this.place, this.legend);
    this.card.style.margin = "0";
    this.signature = "";
    this.chart = null;
    this.readouts = [];
    new ResizeObserver(() => this.fit()).observe(this.place);
  }

  fit() {
    const width = Math.floor(this.place.clientWidth);
    if (this.chart && width > 0 && width !== this.chart.width) this.chart.setSize({ width, height: HEIGHT });
  }

  // lines: [{x, y, label, colour, kind, fill}]
  draw(lines, xLabel, format = short) {
    const positive = (y) => (this.log ? y.map((value) => (value > 0 ? value : null)) : y);
    const drawn = lines.map((line) => ({ ...line, y: positive(line.y) })).filter((line) => line.y.some(isNumber));
    this.card.hidden = drawn.length === 0;
    if (drawn.length === 0) return;
    const data = uPlot.join(drawn.map((line) => [line.x, line.y]));
    const signature = JSON.stringify([xLabel, drawn.map((line) => [line.label, line.colour, line.kind, line.fill])]);
    this.format = format;
    this.card.dataset.axis = xLabel;
    if (signature !== this.signature || !this.chart) this.build(drawn, data, xLabel);
    else this.chart.setData(data);
    this.signature = signature;
    this.read(this.chart);
  }

  build(drawn, data, xLabel) {
    this.forget();
    const series = drawn.map(({ colour, kind, fill }) => ({
      stroke: colour,
      width: fill ? 0 : 2,
      fill: fill ? colour : undefined,
      dash: kind === "dash" ? [6, 5] : undefined,
      spanGaps: true,
      ...(kind === "dot" ? { paths: () => null, points: { show: true, size: 7, fill: colour, stroke: colour } } : { points: fill ? { show: false } : { size: 5 } }),
    }));
    this.readouts = drawn.map((line) => element("b"));
    this.legend.replaceChildren(
      ...drawn.map((line, number) => element("li", {}, swatch(line.colour, line.fill ? "block" : line.kind), line.label, this.readouts[number])),
    );
    this.legend.hidden = Boolean(drawn[0].fill);
    this.chart = new uPlot(
      {
        width: Math.max(200, Math.floor(this.place.clientWidth)),
        height: HEIGHT,
        padding: [10, 14, 0, 0],
        legend: { show: false },
        cursor: { sync: { key: "runs" }, drag: { x: true, y: false }, points: { size: 6 } },
        scales: { x: { time: false }, y: this.log ? { distr: 3 } : { range: rangeOf(this.zero) } },
        axes: axesOf(xLabel, this.log),
        series: [{}, ...series],
        hooks: { setCursor: [(chart) => this.read(chart)] },
      },
      data,
      this.place,
    );
  }

  // The values under the cursor, or else the newest.
  read(chart) {
    const at = chart.cursor.idx;
    this.readouts.forEach((place, number) => {
      const values = chart.data[number + 1] ?? [];
      let index = at ?? values.length - 1;
      while (index > 0 && !isNumber(values[index])) index -= 1;
      place.textContent = this.format(values[index]);
    });
  }

  forget() {
    if (this.chart) this.chart.destroy();
    this.chart = null;
  }
}

// Phases on top of each other: the sum of the first, of the first two, ...; the largest is drawn first.
export function stacked(columns, parts, x) {
  const sums = new Array(x.length).fill(0);
  const lines = parts
    .filter((part) => (columns[part.column] ?? []).some(isNumber))
    .map((part) => {
      const own = columns[part.column];
      const y = x.map((_, row) => (sums[row] += isNumber(own[row]) ? own[row] : 0));
      return { x, y, label: part.label, colour: part.colour, fill: true };
    });
  return lines.reverse();
}

// The mean share of each phase in the newest rows, as a bar and in numbers.
export function shares(columns, { title, parts }) {
  const known = parts
    .map((part) => ({ ...part, mean: meanOfLast(columns[part.column] ?? [], NEWEST) }))
    .filter((part) => isNumber(part.mean));
  const total = known.reduce((sum, part) => sum + part.mean, 0);
  if (!(total > 0)) return null;
  const stack = element("div", { class: "stack", role: "img", "aria-label": known.map((part) => `${part.label} ${Math.round((100 * part.mean) / total)} %`).join(", ") });
  for (const part of known) {
    const block = element("div", { title: part.label });
    block.style.background = part.colour;
    block.style.width = `${(100 * part.mean) / total}%`;
    stack.append(block);
  }
  const items = known.map((part) => element("li", {}, swatch(part.colour, "block"), part.label, element("b", {}, `${seconds(part.mean)}, ${Math.round((100 * part.mean) / total)} %`)));
  return element("div", {}, element("h3", {}, title, element("span", { class: "of" }, ` ${seconds(total)}, mean of the newest ${Math.min(NEWEST, columns.version.length)} points`)), stack, element("ul", { class: "parts" }, ...items));
}

function meanOfLast(values, count) {
  const known = values.slice(-count).filter(isNumber);
  return known.length ? known.reduce((sum, value) => sum + value, 0) / known.length : null;
}
