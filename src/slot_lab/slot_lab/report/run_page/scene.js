// The robot in space: torso, bent legs, forces of the ground and the path, for one run or two.

const SEEN = 0.42; // opacity of the second robot when both are over each other

class Robot {
  constructor(T, run, shown, torsoColour) {
    Object.assign(this, { T, run, shown });
    this.group = new T.Group();
    this.materials = [];
    this.torso = this.mesh(new T.BoxGeometry(...shown.torso), torsoColour);
    const colours = shown.colours.legs.map((c) => (run.known ? c : shown.colours.unknown));
    this.legs = colours.map((colour) => this.mesh(this.bar(), colour));
    const up = new T.Vector3(0, 0, 1);
    this.arrows = colours.map(() => new T.ArrowHelper(up, up, 0.05, shown.colours.ink));
    this.arrows.forEach((arrow) => this.group.add(arrow));
    this.path = this.pathLine(torsoColour);
  }

  mesh(geometry, colour) {
    const look = { color: colour, flatShading: true, side: this.T.DoubleSide };
    const material = new this.T.MeshLambertMaterial(look);
    const mesh = new this.T.Mesh(geometry, material);
    mesh.castShadow = true;
    mesh.frustumCulled = false;
    this.materials.push(material);
    this.group.add(mesh);
    return mesh;
  }

  // A leg: four corners at each node, faces between them and at both ends.
  bar() {
    const T = this.T, n = this.run.nodes, index = [];
    for (let i = 0; i < n - 1; i++) {
      for (let k = 0; k < 4; k++) {
        const a = 4 * i + k, b = 4 * i + ((k + 1) % 4);
        index.push(a, b, b + 4, a, b + 4, a + 4);
      }
    }
    const e = 4 * (n - 1);
    index.push(0, 2, 1, 0, 3, 2, e, e + 1, e + 2, e, e + 2, e + 3);
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(12 * n), 3));
    geometry.setIndex(index);
    return geometry;
  }

  pathLine(colour) {
    const { T, run } = this, at = run.columns.position.at;
    const points = new Float32Array(3 * run.frames);
    for (let f = 0; f < run.frames; f++) {
      const start = f * run.width + at;
      points.set([run.table[start], run.table[start + 1], 0.001], 3 * f);
    }
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", new T.BufferAttribute(points, 3));
    const line = new T.Line(geometry, new T.LineBasicMaterial({ color: colour }));
    line.frustumCulled = false;
    this.group.add(line);
    return line;
  }

  get position() {
    return this.torso.position;
  }

  // Places of the four feet, (12,) m.
  feet() {
    const { nodes, columns } = this.run, start = columns.nodes.at;
    return [0, 1, 2, 3].map((leg) => {
      const k = start + 3 * (leg * nodes + nodes - 1);
      return new this.T.Vector3(this.row[k], this.row[k + 1], this.row[k + 2]).add(this.position);
    });
  }

  show(t) {
    const row = (this.row = this.run.rowAt(t)), { position, quaternion } = this.run.columns;
    this.torso.position.fromArray(row, position.at);
    this.torso.quaternion.fromArray(row, quaternion.at).normalize();
    this.legs.forEach((leg, i) => this.bend(leg.geometry, i));
    this.feet().forEach((foot, i) => this.push(this.arrows[i], foot, i));
    this.path.geometry.setDrawRange(0, this.run.frame(t) + 1);
  }

  // Corners c +- w/2 d +- h/2 b of the sections, with b = t x d, t along the leg, d its width.
  bend(geometry, leg) {
    const { run, row, shown } = this, n = run.nodes, points = geometry.attributes.position.array;
    const node = run.columns.nodes.at + 3 * leg * n, wide = run.columns.across.at + 3 * leg * n;
    const p = this.torso.position;
    for (let i = 0; i < n; i++) {
      const before = node + 3 * Math.max(0, i - 1), after = node + 3 * Math.min(n - 1, i + 1);
      let tx = row[after] - row[before], ty = row[after + 1] - row[before + 1];
      let tz = row[after + 2] - row[before + 2];
      const k = wide + 3 * i, dx = row[k], dy = row[k + 1], dz = row[k + 2];
      const bx = ty * dz - tz * dy, by = tz * dx - tx * dz, bz = tx * dy - ty * dx;
      const w = shown.width / 2, h = run.thickness[leg][i] / 2 / (Math.hypot(bx, by, bz) || 1);
      const c = node + 3 * i;
      [[-w, -h], [w, -h], [w, h], [-w, h]].forEach(([u, v], corner) => {
        const o = 12 * i + 3 * corner;
        points[o] = p.x + row[c] + u * dx + v * bx;
        points[o + 1] = p.y + row[c + 1] + u * dy + v * by;
        points[o + 2] = p.z + row[c + 2] + u * dz + v * bz;
      });
    }
    geometry.attributes.position.needsUpdate = true;
  }

  push(arrow, foot, leg) {
    const force = new this.T.Vector3().fromArray(this.row, this.run.columns.force.at + 3 * leg);
    const size = force.length();
    arrow.visible = size > this.shown.least_force;
    if (!arrow.visible) return;
    arrow.position.copy(foot);
    arrow.setDirection(force.divideScalar(size));
    arrow.setLength(this.shown.force_scale * size, 0.012, 0.008);
  }

  fade(opacity) {
    for (const material of this.materials) {
      Object.assign(material, { opacity, transparent: opacity < 1, depthWrite: opacity >= 1 });
      material.needsUpdate = true;
    }
  }
}

class Stage {
  constructor(T, canvas, runs, shown) {
    Object.assign(this, { T, canvas, layout: "beside", azimuth: -1.05, elevation: 0.38, distance: 0.85 });
    this.renderer = new T.WebGLRenderer({ canvas, antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.setClearColor(0xf4f6f8);
    this.scene = new T.Scene();
    this.camera = new T.PerspectiveCamera(35, 1, 0.01, 30);
    this.camera.up.set(0, 0, 1);
    const torso = runs.length > 1 ? shown.colours.runs : [shown.colours.torso];
    this.robots = runs.map((run, i) => new Robot(T, run, shown, torso[i]));
    this.robots.forEach((robot) => this.scene.add(robot.group));
    this.light();
    this.ground();
    this.listen();
  }

  light() {
    const T = this.T;
    this.scene.add(new T.HemisphereLight(0xffffff, 0xaab2ba, 2.2));
    this.sun = new T.DirectionalLight(0xffffff, 1.8);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    const around = this.sun.shadow.camera;
    Object.assign(around, { left: -0.4, right: 0.4, top: 0.4, bottom: -0.4, near: 0.1, far: 3 });
    this.sun.shadow.bias = -0.002;
    this.scene.add(this.sun, this.sun.target);
  }

  // A square of 8 m with lines every 0.1 m, which moves by whole metres, and shadows on it.
  ground() {
    const T = this.T, square = new T.PlaneGeometry(8, 8);
    const lines = new T.Mesh(square, new T.MeshBasicMaterial({ map: this.metre() }));
    const shade = new T.Mesh(square, new T.ShadowMaterial({ opacity: 0.22 }));
    lines.position.z = -0.001;
    shade.receiveShadow = true;
    this.floor = new T.Group();
    this.floor.add(lines, shade);
    this.scene.add(this.floor);
  }

  // Picture of a square metre.
  metre() {
    const T = this.T, canvas = document.createElement("canvas"), size = 1024;
    Object.assign(canvas, { width: size, height: size });
    const pen = canvas.getContext("2d");
    pen.fillStyle = "#f4f6f8";
    pen.fillRect(0, 0, size, size);
    for (let k = 0; k <= 10; k++) {
      const at = (k * size) / 10, wide = k % 10 ? 2 : 8;
      pen.fillStyle = k % 10 ? "#d5dce3" : "#b8c4ce";
      pen.fillRect(at - wide / 2, 0, wide, size);
      pen.fillRect(0, at - wide / 2, size, wide);
    }
    const picture = new T.CanvasTexture(canvas);
    picture.wrapS = picture.wrapT = T.RepeatWrapping;
    picture.repeat.set(8, 8);
    picture.anisotropy = 8;
    picture.colorSpace = T.SRGBColorSpace;
    return picture;
  }

  // Drag turns the camera, wheel and pinch move it.
  listen() {
    const held = new Map(), canvas = this.canvas;
    const spread = () => {
      const [a, b] = [...held.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    const zoom = (factor) => {
      this.distance = Math.min(5, Math.max(0.2, this.distance * factor));
    };
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      held.set(e.pointerId, { x: e.clientX, y: e.clientY });
    });
    canvas.addEventListener("pointermove", (e) => {
      const last = held.get(e.pointerId);
      if (!last) return;
      const before = held.size === 2 ? spread() : 0;
      if (held.size === 1) {
        this.azimuth -= (e.clientX - last.x) * 0.008;
        const tilt = this.elevation + (e.clientY - last.y) * 0.008;
        this.elevation = Math.min(1.5, Math.max(0.02, tilt));
      }
      held.set(e.pointerId, { x: e.clientX, y: e.clientY });
      if (before) zoom(before / Math.max(1, spread()));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (e) => held.delete(e.pointerId));
    }
    canvas.addEventListener("wheel", (e) => {
      zoom(Math.exp(e.deltaY * 0.001));
      e.preventDefault();
    }, { passive: false });
  }

  setLayout(layout) {
    this.layout = layout;
    this.robots.forEach((robot, i) => robot.fade(i && layout === "over" ? SEEN : 1));
  }

  // Pictures: [robots shown, robot that the camera follows, left, bottom, width, height].
  pictures(width, height) {
    const all = this.robots;
    if (all.length === 1 || this.layout === "over") return [[all, all[0], 0, 0, width, height]];
    const [a, b] = all, w = width / 2, h = height / 2;
    if (width >= height) return [[[a], a, 0, 0, w, height], [[b], b, w, 0, w, height]];
    return [[[a], a, 0, h, width, h], [[b], b, 0, 0, width, h]];
  }

  draw(t) {
    const { renderer, canvas, robots } = this;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    const ratio = Math.min(window.devicePixelRatio, 2);
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) {
      renderer.setPixelRatio(ratio);
      renderer.setSize(width, height, false);
    }
    robots.forEach((robot) => robot.show(t));
    renderer.setScissorTest(true);
    for (const [shown, followed, left, bottom, w, h] of this.pictures(width, height)) {
      robots.forEach((robot) => (robot.group.visible = shown.includes(robot)));
      this.follow(followed.position, w / h);
      renderer.setViewport(left, bottom, w, h);
      renderer.setScissor(left, bottom, w, h);
      renderer.render(this.scene, this.camera);
    }
  }

  follow(p, aspect) {
    const { camera, azimuth, elevation } = this;
    const away = this.distance * Math.max(1, 1.1 / aspect), flat = away * Math.cos(elevation);
    const x = flat * Math.cos(azimuth), y = flat * Math.sin(azimuth);
    camera.aspect = aspect;
    camera.updateProjectionMatrix();
    camera.position.set(p.x + x, p.y + y, 0.05 + away * Math.sin(elevation));
    camera.lookAt(p.x, p.y, 0.05);
    this.floor.position.set(Math.round(p.x), Math.round(p.y), 0);
    this.sun.position.set(p.x + 0.25, p.y - 0.45, 0.86);
    this.sun.target.position.set(p.x, p.y, 0);
  }

  // Distance of the torsos, and the largest one of two feet, m.
  apart() {
    const [a, b] = this.robots, other = b.feet();
    return [a.position.distanceTo(b.position),
      Math.max(...a.feet().map((foot, i) => foot.distanceTo(other[i])))];
  }
}
