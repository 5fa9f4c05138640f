"use strict";
const each = (selector, use) => document.querySelectorAll(selector).forEach(use);
const place = (event, svg) => {
  const box = svg.getBoundingClientRect(), unit = svg.viewBox.baseVal.width / box.width;
  return [(event.clientX - box.left) * unit, (event.clientY - box.top) * unit];
};

each(".chart", (chart) => {
  const data = JSON.parse(chart.dataset.curves), svg = chart.querySelector("svg"), cursor = svg.querySelector(".cursor");
  const rows = chart.querySelectorAll("data"), name = chart.querySelector("output");
  let at = data.chosen;
  const show = (k) => {
    at = Math.max(0, Math.min(data.x.length - 1, k));
    const line = cursor.querySelector("path").getAttribute("d").replace(/^M[^ ]*/, "M" + data.x[at]);
    const dots = data.y.map((y, c) => (y[at] === null ? "" : `<circle class="c${data.colours[c]}" cx="${data.x[at]}" cy="${y[at]}" r="4.5"/>`));
    cursor.innerHTML = `<path d="${line}"/>` + dots.join("");
    name.textContent = data.names[at];
    rows.forEach((row, c) => (row.textContent = data.values[c][at]));
  };
  const nearest = (x) => data.x.reduce((best, other, k) => (Math.abs(other - x) < Math.abs(data.x[best] - x) ? k : best), 0);
  svg.addEventListener("pointermove", (event) => show(nearest(place(event, svg)[0])));
  svg.addEventListener("pointerdown", (event) => show(nearest(place(event, svg)[0])));
  svg.addEventListener("pointerleave", () => show(data.chosen));
  svg.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: data.x.length - 1 };
    if (event.key in steps) { show(steps[event.key]); event.preventDefault(); }
  });
  show(at);
});

each(".map[data-map]", (map) => {
  const data = JSON.parse(map.dataset.map), svg = map.querySelector("svg"), said = map.querySelector("output");
  const [left, top, right, bottom] = data.box;
  svg.addEventListener("pointermove", (event) => {
    const [x, y] = place(event, svg), row = data.rows[Math.floor((y - top) / (bottom - top) * data.rows.length)];
    const value = row && row[Math.floor((x - left) / (right - left) * row.length)];
    said.textContent = value === undefined || value === null ? "" : `${value} ${data.unit}`;
  });
  svg.addEventListener("pointerleave", () => (said.textContent = ""));
});

each(".stack", (stack) => {
  stack.querySelector("input").addEventListener("input", (event) => stack.style.setProperty("--at", event.target.value + "%"));
});

each(".solid", (solid) => {
  const mesh = JSON.parse(solid.dataset.mesh), canvas = solid.querySelector("canvas"), pen = canvas.getContext("2d");
  const [turn, tilt] = solid.querySelectorAll("input");
  const corners = [-1, 1].flatMap((z) => [-1, 1].flatMap((y) => [-1, 1].map((x) => [x, y, z].map((sign, k) => sign * mesh.half[k]))));
  const reach = Math.hypot(...mesh.half);
  const quads = [];
  for (let r = 0; r + 1 < mesh.rows; r++) for (let c = 0; c + 1 < mesh.columns; c++) {
    const k = r * mesh.columns + c, quad = [k, k + 1, k + mesh.columns + 1, k + mesh.columns].filter((v) => mesh.vertices[3 * v] !== null);
    if (quad.length > 2) quads.push(quad);
  }
  const draw = () => {
    const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = canvas.clientHeight, size = Math.min((wide - 104) / 2, (high - 50) / 1.6) / reach;
    canvas.width = wide * ratio; canvas.height = high * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [a, b] = [turn, tilt].map((input) => input.value * Math.PI / 180), [ca, sa, cb, sb] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b)];
    const seen = ([x, y, z]) => [ca * x - sa * y, sb * (sa * x + ca * y) + cb * z, cb * (sa * x + ca * y) - sb * z];
    const flat = ([x, y]) => [wide / 2 + size * x, high / 2 - size * y];
    const style = getComputedStyle(solid), ink = style.getPropertyValue("--ink"), faint = style.getPropertyValue("--faint");
    const box = corners.map(seen), far = box.reduce((best, corner, k) => (corner[2] > box[best][2] ? k : best), 0);
    const edges = box.flatMap((_, k) => [1, 2, 4].filter((bit) => !(k & bit)).map((bit) => [k, k | bit]));
    const lines = (some) => {
      pen.strokeStyle = faint; pen.lineWidth = 0.8; pen.beginPath();
      for (const [from, to] of some) { pen.moveTo(...flat(box[from])); pen.lineTo(...flat(box[to])); }
      pen.stroke();
    };
    lines(edges.filter((edge) => edge.includes(far)));
    const at = Array.from({ length: mesh.rows * mesh.columns }, (_, k) => mesh.vertices[3 * k] === null ? null : seen(mesh.vertices.slice(3 * k, 3 * k + 3)));
    const depth = (quad) => quad.reduce((sum, v) => sum + at[v][2], 0) / quad.length;
    for (const [, quad] of quads.map((quad) => [depth(quad), quad]).sort((p, q) => q[0] - p[0])) {
      const [p, q, s] = quad.map((v) => at[v]), u = q.map((x, k) => x - p[k]), v = s.map((x, k) => x - p[k]);
      const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const light = Math.abs(-0.45 * normal[0] + 0.55 * normal[1] - 0.7 * normal[2]) / (Math.hypot(...normal) || 1);
      const height = quad.reduce((sum, k) => sum + mesh.vertices[3 * k + 2], 0) / quad.length / (mesh.half[2] || 1);
      const colour = mesh.colours[Math.round((Math.max(-1, Math.min(1, height)) + 1) / 2 * (mesh.colours.length - 1))];
      pen.fillStyle = pen.strokeStyle = `rgb(${colour.map((part) => Math.round(part * (0.5 + 0.5 * light)))})`;
      pen.lineWidth = 0.7; pen.beginPath();
      quad.forEach((k, n) => (n ? pen.lineTo : pen.moveTo).apply(pen, flat(at[k])));
      pen.closePath(); pen.fill(); pen.stroke();
    }
    pen.fillStyle = ink; pen.font = "13px system-ui, sans-serif"; pen.textBaseline = "middle";
    const rim = (bit) => edges.filter(([from, to]) => (from ^ to) === bit).sort((p, q) => score(q, bit) - score(p, bit))[0];
    const score = ([from, to], bit) => bit === 4 ? -(box[from][0] + box[to][0]) : -(box[from][1] + box[to][1]);
    [1, 2, 4].forEach((bit, axis) => {
      const edge = rim(bit);
      lines([edge]);
      const [p, q] = edge.map((k) => flat(box[k])), middle = [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2];
      const out = axis === 2 ? [-1, 0] : [middle[0] > wide / 2 ? 0.7 : -0.7, 0.7];
      pen.textAlign = axis === 2 || out[0] < 0 ? "right" : "left";
      const [name, [low, high]] = [mesh.names[axis], mesh.ends[axis]];
      const roomy = Math.hypot(p[0] - q[0], p[1] - q[1]) > 70;
      const words = roomy ? [[p, low, 0.12], [middle, name, 0], [q, high, -0.12]] : [[middle, `${name} ${low} to ${high}`, 0]];
      words.forEach(([[x, y], word, in_]) => {
        pen.fillText(word, x + in_ * (q[0] - p[0]) + 9 * out[0], y + in_ * (q[1] - p[1]) + 14 * out[1]);
      });
    });
  };
  let grip = null;
  canvas.addEventListener("pointerdown", (event) => {
    grip = [event.clientX, event.clientY, +turn.value, +tilt.value];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!grip) return;
    turn.value = ((grip[2] + (event.clientX - grip[0]) / 2 + 540) % 360 + 360) % 360 - 180;
    tilt.value = grip[3] + (event.clientY - grip[1]) / 2;
    draw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (grip = null));
  [turn, tilt].forEach((input) => input.addEventListener("input", draw));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  new ResizeObserver(draw).observe(canvas);
});
