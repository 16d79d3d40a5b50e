// Numbers and times as text, and elements whose text is only ever set as text.

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "class") made.className = value;
    else made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

// A line or block in a colour. Through the style object: the page's policy allows no inline styles.
export function swatch(colour, kind = "line") {
  const made = element("span", { class: kind === "line" ? "swatch" : `swatch ${kind}`, "aria-hidden": "true" });
  if (kind === "dash") made.style.borderTopColor = colour;
  else made.style.background = colour;
  return made;
}

export function isNumber(value) {
  return typeof value === "number" && Number.isFinite(value);
}

// Up to three significant digits after thousands, millions, ... were taken out.
export function short(value) {
  if (!isNumber(value)) return "-";
  const size = Math.abs(value);
  for (const [unit, suffix] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]]) {
    if (size >= Math.max(unit * 0.99995, 9999.5)) return trimmed((value / unit).toPrecision(4)) + suffix;
  }
  if (size >= 999.95) return whole(value);
  if (size !== 0 && size < 1e-3) return value.toExponential(1);
  return trimmed(value.toPrecision(size >= 100 ? 4 : 3));
}

function trimmed(text) {
  return text.includes(".") && !text.includes("e") ? text.replace(/\.?0+$/, "") : text;
}

export function whole(value) {
  return isNumber(value) ? Math.round(value).toLocaleString("en-US") : "-";
}

export function fixed(value, digits) {
  return isNumber(value) ? value.toLocaleString("en-US", { minimumFractionDigits: digits, maximumFractionDigits: digits }) : "-";
}

export function seconds(value) {
  if (!isNumber(value)) return "-";
  if (value < 0.001) return `${fixed(value * 1e6, 0)} µs`;
  if (value < 1) return `${short(value * 1000)} ms`;
  return `${short(value)} s`;
}

export function duration(value) {
  if (!isNumber(value)) return "-";
  if (value < 10) return `${value.toFixed(1)} s`;
  if (value < 120) return `${Math.round(value)} s`;
  const minutes = Math.round(value / 60);
  return minutes < 120 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export function clock(unixSeconds) {
  const when = new Date(unixSeconds * 1000);
  return when.toLocaleTimeString("en-GB");
}
