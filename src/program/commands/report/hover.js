// Interactive readout of the charts: a vertical line at the x nearest to the pointer, dots on the
// curves, and their values. The charts are complete without this script.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
// Largest number of values shown at once.
const MOST_ROWS = 8;
// Largest distance beyond the end of a curve at which the readout shows the last value, in units
// of the chart.
const NEAR = 12;

const element = (name, attributes, parent) => {
  const node = document.createElementNS(SVG, name);
  for (const key in attributes) node.setAttribute(key, attributes[key]);
  return parent.appendChild(node);
};

const format = (value) => {
  const size = Math.abs(value);
  if (value === 0 || Number.isInteger(value) && size < 1e5) return String(value);
  return size < 1e-2 || size >= 1e5 ? value.toExponential(3) : value.toPrecision(4);
};

// Index of the entry nearest to `x` in an increasing list.
const nearest = (xs, x) => {
  let low = 0, high = xs.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (xs[middle] < x) low = middle; else high = middle;
  }
  return x - xs[low] <= xs[high] - x ? low : high;
};

const activate = (chart) => {
  const data = JSON.parse(chart.querySelector("script").textContent);
  const picture = chart.querySelector("svg");
  const readout = chart.querySelector(".readout");
  const between = (from, to, at) => to[0] + (to[1] - to[0]) * (at - from[0]) / (from[1] - from[0]);
  const right = (x) => between(data.x, data.across, x);
  const down = (y) => between(data.y, data.up, data.log ? Math.log10(y) : y);
  const all = [...new Set(data.series.flatMap((line) => line.points.map((point) => point[0])))].sort((a, b) => a - b);
  data.series.forEach((line) => { line.xs = line.points.map((point) => point[0]); });

  const cursor = element("g", { visibility: "hidden", "pointer-events": "none" }, picture);
  const rule = element("line", { y1: data.up[0], y2: data.up[1], stroke: "#444", "stroke-dasharray": "3 3" }, cursor);
  const dots = data.series.map((line) =>
    element("circle", { r: 4, fill: line.color, stroke: "white", "stroke-width": 1.5 }, cursor));
  let index = all.length - 1, height = data.up[1];

  const hide = () => {
    cursor.setAttribute("visibility", "hidden");
    readout.hidden = true;
  };

  // Shows the values of the curves at `all[i]`, or the MOST_ROWS values nearest to the height `y`.
  const show = (i, y) => {
    index = Math.max(0, Math.min(all.length - 1, i));
    const x = all[index];
    rule.setAttribute("x1", right(x));
    rule.setAttribute("x2", right(x));
    dots.forEach((dot) => dot.setAttribute("visibility", "hidden"));
    const rows = [];
    data.series.forEach((line, number) => {
      const [at, value, low, high] = line.points[nearest(line.xs, x)];
      if ((x < line.xs[0] || x > line.xs[line.xs.length - 1]) && Math.abs(right(at) - right(x)) > NEAR) return;
      rows.push({ line, number, at, value, low, high });
    });
    const chosen = [...rows].sort((a, b) => Math.abs(down(a.value) - y) - Math.abs(down(b.value) - y)).slice(0, MOST_ROWS);
    readout.replaceChildren();
    readout.append(Object.assign(document.createElement("b"), { textContent: `${data.x_label} ${format(x)}` }));
    for (const row of rows.filter((row) => chosen.includes(row))) {
      const dot = dots[row.number];
      dot.setAttribute("cx", right(row.at));
      dot.setAttribute("cy", down(row.value));
      dot.setAttribute("visibility", "inherit");
      const text = document.createElement("span");
      const band = row.low === undefined ? "" : ` (${format(row.low)} to ${format(row.high)})`;
      text.textContent = `${row.line.label}: ${format(row.value)}${band}`;
      text.style.borderColor = row.line.color;
      readout.append(text);
    }
    cursor.setAttribute("visibility", "visible");
    readout.hidden = false;
    // Places the readout beside the line, on the side with more space, within the chart.
    const width = chart.clientWidth, scale = width / data.size[0], place = right(x) * scale;
    const left = place > width / 2 ? place - readout.offsetWidth - 10 : place + 10;
    readout.style.left = `${Math.max(0, Math.min(width - readout.offsetWidth, left))}px`;
  };

  chart.addEventListener("pointermove", (event) => {
    const box = picture.getBoundingClientRect(), scale = data.size[0] / box.width;
    const [x, y] = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    show(nearest(all, between(data.across, data.x, x)), y);
  });
  chart.addEventListener("pointerleave", hide);
  chart.addEventListener("blur", hide);
  chart.addEventListener("keydown", (event) => {
    const places = { ArrowLeft: index - 1, ArrowRight: index + 1, Home: 0, End: all.length - 1, ArrowUp: index, ArrowDown: index };
    if (event.key === "Escape") hide();
    if (!(event.key in places)) return;
    event.preventDefault();
    // Up and down select among the curves if there are more than the readout shows.
    const step = { ArrowUp: -0.1, ArrowDown: 0.1 }[event.key] ?? 0;
    height = Math.max(data.up[1], Math.min(data.up[0], height + step * (data.up[0] - data.up[1])));
    show(readout.hidden ? index : places[event.key], height);
  });
};

document.querySelectorAll(".chart").forEach(activate);
document.querySelectorAll(".hint").forEach((hint) => { hint.hidden = false; });
