// Plots over time with a cursor: their values stand above them; pressed, they set the time.

const MARGIN = { left: 44, right: 8, top: 6, bottom: 16 };
const DASH = [5, 3]; // of the second run

// Step of 1, 2 or 5 times a power of ten for at most so many intervals.
function niceStep(span, most) {
  const least = span / most, power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((m) => m * power >= least * 0.999);
}

function written(value) {
  if (Number.isNaN(value)) return "-";
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
}

class Plot {
  constructor(shown, runs, duration, host, seek) {
    Object.assign(this, { runs, duration, difference: false, hover: null });
    this.curves = shown.curves.flatMap(({ column, names, colours }) =>
      names.map((name, i) => ({ name, colour: colours[i], column, i })));
    const figure = host.appendChild(document.createElement("figure"));
    const caption = figure.appendChild(document.createElement("figcaption"));
    caption.appendChild(document.createElement("b")).textContent = shown.title;
    this.values = this.curves.map((curve) => this.label(caption, curve));
    this.canvas = figure.appendChild(document.createElement("canvas"));
    this.still = document.createElement("canvas"); // all but the cursor
    this.listen(seek);
    this.compute();
  }

  label(caption, { name, colour }) {
    const item = caption.appendChild(document.createElement("span"));
    item.appendChild(document.createElement("i")).style.background = colour;
    item.append(`${name} `);
    return item.appendChild(document.createElement("span"));
  }

  listen(seek) {
    const canvas = this.canvas;
    const time = (e) => {
      const x = e.clientX - canvas.getBoundingClientRect().left - MARGIN.left;
      const share = x / (canvas.clientWidth - MARGIN.left - MARGIN.right);
      return this.duration * Math.min(1, Math.max(0, share));
    };
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      seek(time(e));
    });
    canvas.addEventListener("pointermove", (e) => {
      if (e.buttons) seek(time(e));
      this.hover = e.pointerType === "mouse" ? time(e) : null;
    });
    canvas.addEventListener("pointerleave", () => (this.hover = null));
  }

  place(run, { column, i }) {
    const found = run.columns[column];
    return found === undefined ? null : found.at + i;
  }

  // Value of a curve in a run; NaN where the run lacks it, and after its end.
  value(run, curve, t) {
    const place = this.place(run, curve);
    return place === null || t > run.duration + 1e-6 ? NaN : run.at(place, t);
  }

  // Lines as arrays of [time, value], and the range of all values.
  compute() {
    const [first, second] = this.runs, times = (run) => Array.from({ length: run.frames },
      (_, f) => run.time(f));
    this.lines = [];
    const add = (curve, run, value, dash) => this.lines.push({
      colour: curve.colour, dash, points: times(run).map((t) => [t, value(t)]) });
    for (const curve of this.curves) {
      if (this.difference) {
        add(curve, first, (t) => this.value(second, curve, t) - this.value(first, curve, t), []);
        continue;
      }
      this.runs.forEach((run, k) => add(curve, run, (t) => this.value(run, curve, t), k ? DASH : []));
    }
    const all = this.lines.flatMap((line) => line.points.map((p) => p[1])).filter(Number.isFinite);
    let low = Infinity, high = -Infinity;
    for (const value of all) { low = Math.min(low, value); high = Math.max(high, value); }
    if (low > high) [low, high] = [0, 1];
    const least = Math.max(1e-9, 1e-3 * Math.max(Math.abs(low), Math.abs(high)));
    const pad = Math.max(0.06 * (high - low), least);
    [this.low, this.high] = [low - pad, high + pad];
    this.size = "";
  }

  setDifference(difference) {
    this.difference = difference;
    this.compute();
  }

  draw(t) {
    const ratio = Math.min(window.devicePixelRatio, 2);
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    const size = `${width} ${height} ${ratio}`;
    if (size !== this.size) {
      this.size = size;
      for (const canvas of [this.canvas, this.still]) {
        Object.assign(canvas, { width: width * ratio, height: height * ratio });
      }
      this.drawLines(width, height, ratio);
    }
    const pen = this.canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.drawImage(this.still, 0, 0);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawCursor(pen, t, "#22282e", height, width);
    if (this.hover !== null) this.drawCursor(pen, this.hover, "#8796a5", height, width);
  }

  x(t, width) {
    return MARGIN.left + (t / (this.duration || 1)) * (width - MARGIN.left - MARGIN.right);
  }

  y(value, height) {
    const share = (value - this.low) / (this.high - this.low);
    return height - MARGIN.bottom - share * (height - MARGIN.top - MARGIN.bottom);
  }

  drawCursor(pen, t, colour, height, width) {
    pen.strokeStyle = colour;
    pen.beginPath();
    pen.moveTo(this.x(t, width), MARGIN.top);
    pen.lineTo(this.x(t, width), height - MARGIN.bottom);
    pen.stroke();
  }

  drawLines(width, height, ratio) {
    const pen = this.still.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawGrid(pen, width, height);
    pen.lineWidth = 1.3;
    for (const { colour, dash, points } of this.lines) {
      pen.strokeStyle = colour;
      pen.setLineDash(dash);
      pen.beginPath();
      let down = false;
      for (const [t, value] of points) {
        const known = Number.isFinite(value);
        if (known) pen[down ? "lineTo" : "moveTo"](this.x(t, width), this.y(value, height));
        down = known;
      }
      pen.stroke();
    }
  }

  drawGrid(pen, width, height) {
    Object.assign(pen, { font: "11px system-ui, sans-serif", fillStyle: "#5c6670" });
    Object.assign(pen, { strokeStyle: "#e2e7eb", textAlign: "right", textBaseline: "middle" });
    pen.beginPath();
    const step = niceStep(this.high - this.low, 6);
    const digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
    for (let v = Math.ceil(this.low / step) * step; v <= this.high; v += step) {
      const y = Math.round(this.y(v, height)) + 0.5;
      pen.moveTo(MARGIN.left, y);
      pen.lineTo(width - MARGIN.right, y);
      pen.fillText((Math.abs(v) < step / 2 ? 0 : v).toFixed(Math.min(6, digits)), MARGIN.left - 4, y);
    }
    Object.assign(pen, { textAlign: "center", textBaseline: "top" });
    const ticks = niceStep(this.duration || 1, Math.max(2, width / 80));
    for (let t = 0; t <= this.duration; t += ticks) {
      const x = Math.round(this.x(t, width)) + 0.5;
      pen.moveTo(x, MARGIN.top);
      pen.lineTo(x, height - MARGIN.bottom);
      pen.fillText(`${+t.toFixed(6)} s`, Math.min(x, width - 16), height - MARGIN.bottom + 3);
    }
    pen.stroke();
  }

  // Write the values at the cursor, else at the time shown.
  write(t) {
    const at = this.hover ?? t;
    this.curves.forEach((curve, i) => {
      const values = this.runs.map((run) => this.value(run, curve, at));
      const shown = this.difference ? [values[1] - values[0]] : values;
      this.values[i].textContent = shown.map(written).join(" | ");
    });
  }
}
