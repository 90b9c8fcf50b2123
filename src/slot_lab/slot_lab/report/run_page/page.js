// The page: reads its content, then shows the time that the controls set.

const $ = (id) => document.getElementById(id);
const TEXT_PERIOD = 100; // ms between two changes of the numbers on the page
const LONGEST_STEP = 0.1; // s of real time, after a pause of the browser

async function readThree() {
  const text = async (id) => new TextDecoder().decode(await inflated($(id).textContent));
  const address = (code) => URL.createObjectURL(new Blob([code], { type: "text/javascript" }));
  const core = address(await text("three-core"));
  const module = (await text("three-module")).replaceAll("./three.core.min.js", core);
  return import(address(module));
}

// A stage, or null where the browser has no WebGL: the plots work without it.
async function makeStage(runs, shown) {
  const three = await readThree();
  try {
    return new Stage(three, $("scene"), runs, shown);
  } catch (error) {
    $("message").textContent = `The robot is not shown: ${error.message}`;
    return null;
  }
}

class Page {
  constructor(shown, runs, stage) {
    Object.assign(this, { runs, stage, t: 0, speed: 1, last: null, written: -Infinity });
    this.duration = Math.max(...runs.map((run) => run.duration));
    const seek = (t) => this.seek(t);
    this.plots = shown.plots.map((p) => new Plot(p, runs, this.duration, $("plots"), seek));
    this.playing = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    $("time").max = this.duration;
    this.listen();
    if (runs.length > 1) this.showPair(shown.colours.runs);
    this.readAddress();
  }

  listen() {
    $("play").addEventListener("click", () => this.play(!this.playing));
    $("time").addEventListener("input", () => this.seek(Number($("time").value)));
    $("speed").addEventListener("change", () => (this.speed = Number($("speed").value)));
    $("difference").addEventListener("change", () => this.setDifference($("difference").checked));
    for (const button of document.getElementsByName("layout")) {
      button.addEventListener("change", () => this.setLayout(button.value));
    }
    document.addEventListener("keydown", (e) => this.key(e));
    window.addEventListener("hashchange", () => this.readAddress());
  }

  showPair(colours) {
    $("pair").hidden = false;
    this.names = this.runs.map((run, i) => {
      const name = $("names").appendChild(document.createElement("span"));
      name.style.borderColor = colours[i];
      return name;
    });
    this.setLayout("beside");
  }

  // What an address may say after #: t=SECONDS, speed=N, layout=over, difference
  readAddress() {
    const said = new URLSearchParams(location.hash.slice(1));
    if (said.has("t")) this.seek(Number(said.get("t")) || 0);
    const speed = [...$("speed").options].map((o) => o.value).find((v) => v === said.get("speed"));
    if (speed) this.speed = Number(($("speed").value = speed));
    if (this.runs.length < 2) return;
    if (said.has("layout")) this.setLayout(said.get("layout") === "over" ? "over" : "beside");
    if (said.has("difference")) this.setDifference(true);
  }

  key(e) {
    if (["SELECT", "INPUT"].includes(e.target.tagName)) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
    if (step) this.seek(this.runs[0].time(Math.max(0, this.runs[0].frame(this.t) + step)));
    if (e.key === " " && e.target.tagName !== "BUTTON") this.play(!this.playing);
    if (step || e.key === " ") e.preventDefault();
  }

  play(playing) {
    if (playing && this.t >= this.duration) this.t = 0;
    this.playing = playing;
  }

  seek(t) {
    this.t = Math.min(this.duration, Math.max(0, Number.isFinite(t) ? t : 0));
    this.playing = false;
    this.written = -Infinity;
  }

  setLayout(layout) {
    document.querySelector(`input[value=${layout}]`).checked = true;
    this.stage?.setLayout(layout);
    this.placeNames(layout);
  }

  // Each name stands in the corner of its picture.
  placeNames(layout = this.stage?.layout ?? "beside") {
    const { clientWidth: width, clientHeight: height } = $("view"), wide = width >= height;
    this.names.forEach((name, i) => {
      const below = layout === "over" ? `${8 + 26 * i}px` : wide || !i ? "8px" : "calc(50% + 8px)";
      Object.assign(name.style, { top: below, left: i && layout !== "over" && wide ? "50%" : "0" });
    });
  }

  setDifference(difference) {
    $("difference").checked = difference;
    this.plots.forEach((plot) => plot.setDifference(difference));
    this.written = -Infinity;
  }

  frame(now) {
    const passed = this.last === null ? 0 : (now - this.last) / 1e3;
    this.last = now;
    if (this.playing) this.t += this.speed * Math.min(passed, LONGEST_STEP);
    if (this.playing && this.t > this.duration) this.t = 0;
    const look = this.look();
    if (look !== this.drawn) {
      this.drawn = look;
      this.stale = true;
      this.stage?.draw(this.t);
      this.plots.forEach((plot) => plot.draw(this.t));
    }
    if (this.stale && now - this.written > TEXT_PERIOD) this.write(now);
  }

  // All that the pictures depend on: while nothing changes, nothing is drawn.
  look() {
    const s = this.stage, sizes = [$("view"), $("plots")].map((e) => [e.clientWidth, e.clientHeight]);
    const seen = s && [s.layout, s.azimuth, s.elevation, s.distance];
    const hover = this.plots.map((plot) => plot.hover);
    return JSON.stringify([this.t, this.playing, $("difference").checked, sizes, seen, hover]);
  }

  write(now) {
    this.written = now;
    this.stale = false;
    $("time").value = this.t;
    $("clock").textContent = `${this.t.toFixed(2)} of ${this.duration.toFixed(2)} s`;
    $("play").textContent = this.playing ? "II" : "\u25B6";
    this.plots.forEach((plot) => plot.write(this.t));
    const lines = this.runs.map((run) => run.statesAt(this.t).map((s) => s.join(" ")).join(", "));
    if (lines.length > 1) ["first: ", "second: "].forEach((name, i) => (lines[i] = name + lines[i]));
    $("states").replaceChildren(...lines.map((line) => {
      const part = document.createElement("span");
      part.textContent = line;
      return part;
    }));
    if (this.runs.length > 1) this.writePair();
  }

  writePair() {
    this.placeNames();
    this.runs.forEach((run, i) => {
      const ended = this.t > run.duration + 1e-6 ? " (ended)" : "";
      this.names[i].textContent = `${["first", "second"][i]}: ${run.name}${ended}`;
    });
    if (!this.stage) return;
    const [torso, foot] = this.stage.apart().map((metres) => (1e3 * metres).toFixed(1));
    $("apart").textContent = `torsos ${torso} mm apart, feet at most ${foot} mm`;
  }
}

async function start() {
  const shown = JSON.parse($("content").textContent);
  const runs = await Promise.all(shown.runs.map(Run.read));
  const page = new Page(shown, runs, await makeStage(runs, shown));
  const loop = (now) => {
    page.frame(now);
    requestAnimationFrame(loop);
  };
  loop(performance.now());
  document.documentElement.dataset.ready = runs.map((run) => run.frames).join(" ");
}

start().catch((error) => {
  $("message").textContent = `The page cannot be shown: ${error.message}`;
  document.documentElement.dataset.error = error.message;
});
