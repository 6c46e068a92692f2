"use strict";

function compare(a, b) {
  if (typeof a === typeof b) return typeof a === "number" ? a - b : a.localeCompare(b);
  return typeof a === "number" ? -1 : 1;
}

function sortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  const read = (row, k) => {
    const text = row.cells[k].textContent.trim();
    const number = parseFloat(text.replace(/^<= /, ""));
    return Number.isNaN(number) ? text : number;
  };
  heads.forEach((head, k) => head.firstElementChild.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    heads.forEach((each) => each.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const rows = [...table.tBodies[0].rows].map((row) => [read(row, k), row]);
    const unknown = (x) => x === "-";
    rows.sort(([a], [b]) => unknown(a) - unknown(b) || (up ? 1 : -1) * compare(a, b));
    table.tBodies[0].append(...rows.map(([, row]) => row));
  }));
}

function ticks(low, high) {
  const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((each) => each * power >= rough) * power, found = [];
  for (let x = Math.ceil(low / step) * step; x <= high + 1e-9 * step; x += step) found.push(+x.toPrecision(6));
  return found;
}

const LEFT = 44, RIGHT = 332, TOP = 8, BOTTOM = 208;
const line = (kind, points) => `<path class="${kind}" d="M${points.map((p) => p.map((x) => x.toFixed(1)).join()).join("L")}"/>`;
const dot = (kind, [x, y]) => `<circle class="${kind}" cx="${x.toFixed(1)}" cy="${y.toFixed(1)}" r="4"/>`;
const text = (x, y, what, anchor) => `<text x="${x}" y="${y}" text-anchor="${anchor}">${what}</text>`;

function axes([x0, x1], [y0, y1]) {
  const x = (v) => LEFT + (RIGHT - LEFT) * (v - x0) / (x1 - x0), y = (v) => BOTTOM - (BOTTOM - TOP) * (v - y0) / (y1 - y0);
  const across = ticks(x0, x1).map((v) => line("frame", [[x(v), TOP], [x(v), BOTTOM]]) + text(x(v), BOTTOM + 13, v, "middle"));
  const up = ticks(y0, y1).map((v) => line("frame", [[LEFT, y(v)], [RIGHT, y(v)]]) + text(LEFT - 4, y(v) + 3, v, "end"));
  return { at: (a, b) => [x(a), y(b)], frame: [...across, ...up].join("") };
}

const metres = (x) => x.toFixed(x >= 100 ? 0 : 1);

function drawCourse(run, k, values, level, name, twin) {
  const end = run.time[run.time.length - 1], top = 1.1 * Math.max(...values, level, ...(twin || []));
  const { at, frame } = axes([0, end], [0, top]), points = (ys) => ys.map((y, i) => at(run.time[i], y));
  return frame + text(RIGHT, BOTTOM + 26, "time since the onset [s]", "end")
    + line("limit", [at(0, level), at(end, level)]) + text(RIGHT, at(0, level)[1] - 3, name, "end") + (twin ? line("clean", points(twin).slice(0, k + 1)) : "")
    + line("attacked ahead", points(values)) + line("attacked", points(values).slice(0, k + 1)) + dot("attacked", points(values)[k])
    + (run.alarm_s === null ? "" : line("alarm", [at(run.alarm_s, 0), at(run.alarm_s, top)]));
}

function drawMap(run, k) {
  const span = Math.max(Math.max(...run.east) - Math.min(...run.east), Math.max(...run.north) - Math.min(...run.north), 1);
  const far = Math.max(...run.off.map(([n, e]) => Math.hypot(n, e)), 1e-3), factor = Math.max(1, Math.floor(0.2 * span / far));
  const north = run.north.map((x, i) => x + factor * run.off[i][0]), east = run.east.map((x, i) => x + factor * run.off[i][1]);
  const middle = (a, b) => (Math.max(...a, ...b) + Math.min(...a, ...b)) / 2, half = (a, b) => (Math.max(...a, ...b) - Math.min(...a, ...b)) / 2;
  const scale = 1.1 * Math.max(half(run.east, east) / (RIGHT - LEFT), half(run.north, north) / (BOTTOM - TOP), 1e-3);
  const range = (a, b, size) => [(middle(a, b) - scale * size) / 1000, (middle(a, b) + scale * size) / 1000];
  const { at, frame } = axes(range(run.east, east, RIGHT - LEFT), range(run.north, north, BOTTOM - TOP));
  const way = (xs, ys) => xs.map((x, i) => at(x / 1000, ys[i] / 1000)), truth = way(run.east, run.north), seen = way(east, north);
  return frame + line("ahead", truth) + line("", truth.slice(0, k + 1)) + line("attacked", seen.slice(0, k + 1)) + dot("attacked", seen[k])
    + text(LEFT, BOTTOM + 26, `offset magnified ${factor} times`, "start") + text(LEFT + 4, TOP + 9, "north [km]", "start") + text(RIGHT, BOTTOM + 26, "east [km]", "end");
}

function drawSky(sky) {
  const place = (azimuth, elevation) => [170 + (90 - elevation) * Math.sin(azimuth * Math.PI / 180), 115 - (90 - elevation) * Math.cos(azimuth * Math.PI / 180)];
  const circle = (elevation) => line("frame", [...Array(61).keys()].map((k) => place(6 * k, elevation)));
  if (!sky) return text(170, 115, "none: this victim takes positions", "middle");
  const name = document.createElement("i");
  return [0, 30, 60].map(circle).join("") + text(170, 20, "N", "middle") + sky.map(([label, azimuth, elevation, state]) => {
    const [x, y] = place(azimuth, elevation);
    name.textContent = label;
    return dot(["authentic", "attacked", "excluded"][state], [x, y]) + text(x + 6, y + 3, name.innerHTML, "start");
  }).join("");
}

function replay(run) {
  const part = (query) => document.querySelector(`#replay ${query}`), slider = part("input");
  const show = () => {
    const k = Number(slider.value), alarmed = run.alarm_s !== null && run.time[k] >= run.alarm_s;
    part("#map").innerHTML = drawMap(run, k);
    part("#sky").innerHTML = drawSky(run.sky[Math.floor(k / 10)]);
    part("#ratio").innerHTML = drawCourse(run, k, run.ratio, 1, "threshold", run.twin);
    part("#error").innerHTML = drawCourse(run, k, run.error, run.limit_m, `alert limit ${run.limit_m} m`);
    part("output").textContent = `${run.time[k]} s: statistic / threshold ${run.ratio[k]}, error ${metres(run.error[k])} m (limit ${run.limit_m} m), ${alarmed ? `alarm at ${run.alarm_s} s` : "no alarm so far"}`;
  };
  const counted = run.error.findIndex((x) => x >= run.undetected_m - 0.01);
  slider.value = counted < 0 ? slider.max : counted;
  slider.addEventListener("input", show);
  show();
}

document.querySelectorAll("table").forEach(sortable);
const run = document.getElementById("run");
if (run) replay(JSON.parse(run.textContent));
