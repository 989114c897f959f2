// Readout, zoom, legend and data of the charts, and the time of the films. Charts and films are
// complete without this script.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
// Largest number of values shown at once.
const MOST_ROWS = 8;
// Largest distance beyond the end of a curve at which the readout shows the last value, in units
// of the chart.
const NEAR = 12;
// Smallest width and height of a dragged rectangle that zooms, in units of the chart.
const DRAG = 8;

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

// The table of a chart as CSV: one row per point.
const csv = (data) => {
  const cell = (text) => /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  const rows = data.series.flatMap((line) =>
    line.points.map(([x, y, low = "", high = ""]) => [cell(line.label), x, y, low, high].join(",")));
  return [["series", cell(data.x_label), cell(data.y_label), "low", "high"].join(","), ...rows, ""].join("\n");
};

const label = (value) => {
  const size = Math.abs(value);
  return value === 0 || size >= 1e-3 && size < 1e5 ? String(Number(value.toPrecision(6))) : value.toExponential();
};

// Ticks of an axis, as [position, label]. Positions on a logarithmic axis are decimal logarithms.
const ticks = ([low, high], log) => {
  if (log && high - low > 0.7) {
    const digits = high - low > 3 ? [1] : [1, 2, 5], step = Math.ceil((high - low) / 8), found = [];
    for (let power = Math.floor(low); power <= high; power++) {
      for (const digit of digits) {
        const at = power + Math.log10(digit);
        if (at >= low && at <= high && power % step === 0) found.push([at, label(Number(`${digit}e${power}`))]);
      }
    }
    return found;
  }
  const [from, to] = log ? [10 ** low, 10 ** high] : [low, high];
  const power = 10 ** Math.floor(Math.log10((to - from) / 5));
  const step = [1, 2, 5, 10].map((digit) => digit * power).find((size) => size >= (to - from) / 5);
  const found = [];
  for (let i = Math.ceil(from / step); i * step <= to; i++) {
    const value = Number((i * step).toPrecision(12));
    found.push([log ? Math.log10(value) : value, label(value)]);
  }
  return found;
};

const button = (text, title, parent, act) => {
  const node = document.createElement("button");
  Object.assign(node, { type: "button", textContent: text, title });
  node.addEventListener("click", act);
  return parent.appendChild(node);
};

let charts = 0;

const activate = (chart) => {
  const data = JSON.parse(chart.querySelector("script").textContent);
  const figure = chart.closest("figure");
  const picture = chart.querySelector("svg");
  const readout = chart.querySelector(".readout");
  const whole = { x: data.x, y: data.y };
  let view = whole;
  const hidden = new Set();
  const between = (from, to, at) => to[0] + (to[1] - to[0]) * (at - from[0]) / (from[1] - from[0]);
  const scaled = (y) => data.log ? Math.log10(y) : y;
  const right = (x) => between(view.x, data.across, x);
  const down = (y) => between(view.y, data.up, scaled(y));
  const all = [...new Set(data.series.flatMap((line) => line.points.map((point) => point[0])))].sort((a, b) => a - b);
  data.series.forEach((line) => { line.xs = line.points.map((point) => point[0]); });

  // Series in a clipped group that zooming moves.
  const clip = `plot-${++charts}`, [left, edge] = data.across, [bottom, top] = data.up;
  const area = { x: left, y: top, width: edge - left, height: bottom - top };
  element("rect", area, element("clipPath", { id: clip }, picture));
  const plot = element("g", {}, element("g", { "clip-path": `url(#${clip})` }, picture));
  picture.querySelectorAll(".series").forEach((series) => plot.append(series));
  const axes = picture.querySelector(".axes");
  const zoomed = element("g", { class: "axes", visibility: "hidden" }, picture);
  const selection = element("rect", { class: "selection", visibility: "hidden" }, picture);

  const cursor = element("g", { visibility: "hidden", "pointer-events": "none" }, picture);
  const rule = element("line", { y1: bottom, y2: top, class: "rule", "stroke-dasharray": "3 3" }, cursor);
  const dots = data.series.map((line) =>
    element("circle", { r: 4, fill: line.color, stroke: "white", "stroke-width": 1.5 }, cursor));
  let index = all.length - 1, height = top;

  const hide = () => {
    cursor.setAttribute("visibility", "hidden");
    readout.hidden = true;
  };

  const draw = (to) => {
    view = to;
    hide();
    const zoom = view !== whole;
    const kx = (whole.x[1] - whole.x[0]) / (view.x[1] - view.x[0]), ky = (whole.y[1] - whole.y[0]) / (view.y[1] - view.y[0]);
    const tx = left - kx * between(whole.x, data.across, view.x[0]), ty = bottom - ky * between(whole.y, data.up, view.y[0]);
    plot.setAttribute("transform", zoom ? `translate(${tx} ${ty}) scale(${kx} ${ky})` : "");
    plot.setAttribute("class", zoom ? "zoomed" : "");
    axes.setAttribute("visibility", zoom ? "hidden" : "visible");
    zoomed.setAttribute("visibility", zoom ? "visible" : "hidden");
    zoomed.replaceChildren();
    const text = (x, y, anchor, content) => {
      element("text", { x, y, "font-size": 12, "text-anchor": anchor }, zoomed).textContent = content;
    };
    for (const [at, name] of ticks(view.x, false)) {
      const x = between(view.x, data.across, at);
      element("line", { x1: x, x2: x, y1: bottom, y2: top, stroke: "#e6e6e6" }, zoomed);
      text(x, bottom + 17, "middle", name);
    }
    for (const [at, name] of ticks(view.y, data.log)) {
      const y = between(view.y, data.up, at);
      element("line", { x1: left, x2: edge, y1: y, y2: y, stroke: "#e6e6e6" }, zoomed);
      text(left - 6, y + 4, "end", name);
    }
    element("path", { d: `M${left} ${top}V${bottom}H${edge}`, fill: "none", stroke: "#444444" }, zoomed);
    text((left + edge) / 2, data.size[1] - 6, "middle", data.x_label);
    reset.disabled = !zoom;
  };

  // Range of x, with the range of y of the visible points.
  const fitted = (x) => {
    const points = data.series.flatMap((line, i) => hidden.has(i) ? [] : line.points);
    const ys = points.filter((point) => point[0] >= x[0] && point[0] <= x[1]).map((point) => scaled(point[1]));
    const [low, high] = [Math.min(...ys), Math.max(...ys)];
    if (!(high > low)) return { x, y: view.y };
    const margin = 0.06 * (high - low);
    return { x, y: [low - margin, high + margin] };
  };
  // Halves the range of x around the read value, or around the middle.
  const closer = () => {
    const middle = readout.hidden ? (view.x[0] + view.x[1]) / 2 : all[index], half = (view.x[1] - view.x[0]) / 4;
    const from = Math.max(whole.x[0], Math.min(whole.x[1] - 2 * half, middle - half));
    draw(fitted([from, from + 2 * half]));
  };

  const bar = document.createElement("div");
  bar.className = "tools";
  chart.before(bar);
  button("+", "Zoom in", bar, closer);
  const reset = button("1:1", "Show the whole chart", bar, () => draw(whole));
  reset.disabled = true;
  button("CSV", "Download the data of this chart", bar, () => {
    const link = document.createElement("a");
    link.href = `data:text/csv;charset=utf-8,${encodeURIComponent(csv(data))}`;
    link.download = `${figure.querySelector("h3").textContent.replace(/[^\w]+/g, "_")}.csv`;
    link.click();
  });

  figure.querySelectorAll(".legend button").forEach((key) => key.addEventListener("click", () => {
    const shown = key.getAttribute("aria-pressed") !== "true";
    key.setAttribute("aria-pressed", shown);
    for (const i of key.dataset.series.split(" ").map(Number)) {
      if (shown) hidden.delete(i); else hidden.add(i);
      plot.querySelectorAll(`[data-series="${i}"]`).forEach((part) => part.setAttribute("visibility", shown ? "visible" : "hidden"));
    }
    hide();
  }));

  // Shows the values of the curves at `all[i]`, or the MOST_ROWS values nearest to the height `y`.
  const show = (i, y) => {
    index = Math.max(0, Math.min(all.length - 1, i));
    const x = all[index];
    if (x < view.x[0] || x > view.x[1]) return hide();
    rule.setAttribute("x1", right(x));
    rule.setAttribute("x2", right(x));
    dots.forEach((dot) => dot.setAttribute("visibility", "hidden"));
    const rows = [];
    data.series.forEach((line, number) => {
      if (line.thin || hidden.has(number)) return;
      const [at, value, low, high] = line.points[nearest(line.xs, x)];
      if ((x < line.xs[0] || x > line.xs[line.xs.length - 1]) && Math.abs(right(at) - right(x)) > NEAR) return;
      if (view !== whole && (down(value) < top || down(value) > bottom)) return;
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
    const side = place > width / 2 ? place - readout.offsetWidth - 10 : place + 10;
    readout.style.left = `${Math.max(0, Math.min(width - readout.offsetWidth, side))}px`;
  };

  const position = (event) => {
    const box = picture.getBoundingClientRect(), scale = data.size[0] / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  };
  const within = (value, [a, b]) => Math.max(Math.min(a, b), Math.min(Math.max(a, b), value));
  const place = (event) => {
    const [x, y] = position(event);
    return [within(x, data.across), within(y, data.up)];
  };
  let start = null;
  chart.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse" && event.button === 0) start = place(event);
  });
  chart.addEventListener("pointermove", (event) => {
    const [x, y] = position(event);
    if (start === null) return show(nearest(all, between(data.across, view.x, x)), y);
    hide();
    const [a, b] = [start, place(event)];
    const shape = { x: Math.min(a[0], b[0]), y: Math.min(a[1], b[1]), width: Math.abs(a[0] - b[0]), height: Math.abs(a[1] - b[1]) };
    for (const key in shape) selection.setAttribute(key, shape[key]);
    selection.setAttribute("visibility", "visible");
  });
  window.addEventListener("pointerup", (event) => {
    if (start === null) return;
    const [a, b] = [start, place(event)];
    start = null;
    selection.setAttribute("visibility", "hidden");
    if (Math.abs(a[0] - b[0]) < DRAG || Math.abs(a[1] - b[1]) < DRAG) return;
    const range = (i, from, to) => [a[i], b[i]].map((at) => between(from, to, at)).sort((p, q) => p - q);
    draw({ x: range(0, data.across, view.x), y: range(1, data.up, view.y) });
  });
  chart.addEventListener("dblclick", () => draw(whole));
  chart.addEventListener("pointerleave", hide);
  chart.addEventListener("blur", hide);
  chart.addEventListener("keydown", (event) => {
    if (event.key === "+") closer();
    if (event.key === "0") draw(whole);
    const places = { ArrowLeft: index - 1, ArrowRight: index + 1, Home: 0, End: all.length - 1, ArrowUp: index, ArrowDown: index };
    if (event.key === "Escape") hide();
    if (!(event.key in places)) return;
    event.preventDefault();
    // Up and down select among the curves if there are more than the readout shows.
    const step = { ArrowUp: -0.1, ArrowDown: 0.1 }[event.key] ?? 0;
    height = Math.max(top, Math.min(bottom, height + step * (bottom - top)));
    show(readout.hidden ? index : places[event.key], height);
  });
};

// Adds a button and a slider that pause a film and set its time.
const play = (film) => {
  const picture = film.querySelector("svg"), moving = picture.querySelector("animate");
  if (moving === null) return;
  const length = parseFloat(moving.getAttribute("dur"));
  const bar = document.createElement("div");
  bar.className = "tools";
  film.append(bar);
  const rename = () => { toggle.textContent = picture.animationsPaused() ? "Play" : "Pause"; };
  const toggle = button("Pause", "Pause or continue the animation", bar, () => {
    if (picture.animationsPaused()) picture.unpauseAnimations(); else picture.pauseAnimations();
    rename();
  });
  const slider = document.createElement("input");
  Object.assign(slider, { type: "range", min: 0, max: length, step: length / 500, value: 0 });
  slider.setAttribute("aria-label", "Time of the animation");
  slider.addEventListener("input", () => {
    picture.pauseAnimations();
    // The end of the loop is the start of the next one.
    picture.setCurrentTime(Math.min(Number(slider.value), length * 0.999));
    rename();
  });
  bar.append(slider);
  const follow = () => {
    if (!picture.animationsPaused()) slider.value = picture.getCurrentTime() % length;
    requestAnimationFrame(follow);
  };
  follow();
};

document.querySelectorAll(".chart").forEach(activate);
document.querySelectorAll(".film").forEach(play);
document.querySelectorAll(".hint").forEach((hint) => { hint.hidden = false; });
