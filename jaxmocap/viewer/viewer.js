// Shows each .jaxmocap-viewer element's scene. Everything from the data is set as text, never as HTML.
"use strict";
(() => {
  const T = JaxmocapThree;

  const make = (tag, parent, properties = {}) => {
    const node = Object.assign(document.createElement(tag), properties);
    parent.append(node);
    return node;
  };

  // Base64 of little-endian 32-bit floats, as every machine with a browser stores them.
  const unpack = (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };

  const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;

  // A round length near the given one: 1, 2 or 5 times a power of ten.
  const round = (length) => {
    const power = 10 ** Math.floor(Math.log10(length));
    return power * [1, 2, 5, 10].reduce((a, b) => (Math.abs(b * power - length) < Math.abs(a * power - length) ? b : a));
  };

  // What the picture shows besides the camera's own view: built once, moved by `show(frame)`.
  const build = (data, root) => {
    const world = new T.Group();
    const r = data.rotation;
    const turn = new T.Matrix4().set(r[0], r[1], r[2], 0, r[3], r[4], r[5], 0, r[6], r[7], r[8], 0, 0, 0, 0, 1);
    world.quaternion.setFromRotationMatrix(turn);
    root.add(world);
    const markers = data.markers && { ...data.markers, p: unpack(data.markers.p) };
    if (markers && markers.sigma) markers.sigma = unpack(markers.sigma);
    const joints = data.skeleton && { ...data.skeleton, p: unpack(data.skeleton.p) };
    const vector = (xyz) => new T.Vector3(...xyz);
    const at = (track, frame, i, out = new T.Vector3()) => {
      const k = 3 * (frame * track.names.length + i);
      return out.set(track.p[k], track.p[k + 1], track.p[k + 2]);
    };
    const finite = (v) => Number.isFinite(v.x + v.y + v.z);

    // The size of what stands there: all frames of markers and joints, or else the cameras.
    const upright = (v) => v.clone().applyMatrix4(turn);
    const low = new T.Vector3(Infinity, Infinity, Infinity), high = low.clone().negate();
    const widen = (v) => { low.min(upright(v)); high.max(upright(v)); };
    for (const track of [markers, joints]) {
      for (let k = 0; track && k + 2 < track.p.length; k += 3) {
        const v = new T.Vector3(track.p[k], track.p[k + 1], track.p[k + 2]);
        if (finite(v)) widen(v);
      }
    }
    const standing = low.x <= high.x;
    if (!standing) for (const camera of data.cameras) widen(vector(camera.centre));
    if (low.x > high.x) { low.set(-1, -1, -1); high.set(1, 1, 1); }
    let size = low.distanceTo(high);
    if (!(size > 0)) size = data.axis ? 0.2 * Math.max(vector(data.axis.point).length(), 1) : 1;
    const centre = low.clone().add(high).multiplyScalar(0.5);

    const parts = { markers: new T.Group(), skeleton: new T.Group(), cameras: new T.Group(), axis: new T.Group(),
      paths: new T.Group(), uncertainty: new T.Group() };
    for (const part of Object.values(parts)) world.add(part);
    const matt = (color, more = {}) => new T.MeshLambertMaterial({ color, ...more });
    const ball = new T.IcosahedronGeometry(1, 3);
    const instances = (geometry, material, n, parent) => {
      const mesh = new T.InstancedMesh(geometry, material, n);
      mesh.frustumCulled = false;
      parent.add(mesh);
      return mesh;
    };
    const lines = (points, color, parent, opacity = 1) => {
      const geometry = new T.BufferGeometry().setFromPoints(points);
      const line = new T.LineSegments(geometry, new T.LineBasicMaterial({ color, transparent: opacity < 1, opacity }));
      line.frustumCulled = false;
      parent.add(line);
      return line;
    };
    const matrix = new T.Matrix4(), nowhere = new T.Matrix4().makeScale(0, 0, 0), still = new T.Quaternion();
    const one = new T.Vector3(), two = new T.Vector3(), scale = new T.Vector3(), up = new T.Vector3(0, 1, 0);
    const radius = 0.013 * size, updates = [], labels = [];
    let enlarged = 0;

    if (joints) {
      // One octahedron along y from 0 to 1, its waist at a fifth; flat faces, so corners are not shared.
      const waist = [[0.09, 0], [0, 0.09], [-0.09, 0], [0, -0.09]].map(([x, z]) => [x, 0.2, z]);
      const corners = waist.flatMap((a, i) => {
        const b = waist[(i + 1) % 4];
        return [b, a, [0, 1, 0], a, b, [0, 0, 0]];
      });
      const bone = new T.BufferGeometry();
      bone.setAttribute("position", new T.BufferAttribute(new Float32Array(corners.flat()), 3));
      bone.computeVertexNormals();
      const n = joints.names.length;
      const bones = instances(bone, matt(0xb7c3d3), n, parts.skeleton);
      const knots = instances(ball, matt(0x3f74b5), n, parts.skeleton);
      updates.push((frame) => {
        for (let i = 0; i < n; i++) {
          at(joints, frame, i, one);
          knots.setMatrixAt(i, finite(one) ? matrix.compose(one, still, scale.setScalar(0.8 * radius)) : nowhere);
          const parent = joints.parents[i];
          if (parent >= 0) at(joints, frame, parent, two); else two.copy(one);
          const length = one.distanceTo(two);
          if (!(length > 0)) { bones.setMatrixAt(i, nowhere); continue; }
          const q = new T.Quaternion().setFromUnitVectors(up, one.clone().sub(two).divideScalar(length));
          bones.setMatrixAt(i, matrix.compose(two, q, scale.setScalar(length)));
        }
        bones.instanceMatrix.needsUpdate = knots.instanceMatrix.needsUpdate = true;
      });
      joints.names.forEach((name, i) => labels.push({ kind: "joint", part: parts.skeleton, name, at: (f) => at(joints, f, i) }));
    }

    if (markers) {
      const n = markers.names.length;
      const balls = instances(ball, matt(0xffffff), n, parts.markers);
      markers.colours.forEach((colour, i) => balls.setColorAt(i, new T.Color(colour)));
      const clouds = markers.sigma &&
        instances(ball, matt(0x8a5a00, { transparent: true, opacity: 0.3, depthWrite: false }), n, parts.uncertainty);
      updates.push((frame) => {
        for (let i = 0; i < n; i++) {
          at(markers, frame, i, one);
          balls.setMatrixAt(i, finite(one) ? matrix.compose(one, still, scale.setScalar(radius)) : nowhere);
          if (!clouds) continue;
          const k = 3 * (frame * n + i);
          scale.set(markers.sigma[k], markers.sigma[k + 1], markers.sigma[k + 2]).multiplyScalar(enlarged);
          clouds.setMatrixAt(i, finite(one) && finite(scale) && enlarged ? matrix.compose(one, still, scale) : nowhere);
        }
        balls.instanceMatrix.needsUpdate = true;
        if (clouds) clouds.instanceMatrix.needsUpdate = true;
      });
      markers.names.forEach((name, i) => labels.push({ kind: "marker", part: parts.markers, name, at: (f) => at(markers, f, i) }));
      if (data.frames.length > 1) {
        for (let i = 0; i < n; i++) {
          const points = [];
          for (let frame = 1; frame < data.frames.length; frame++) {
            const a = at(markers, frame - 1, i), b = at(markers, frame, i);
            if (finite(a) && finite(b)) points.push(a, b);
          }
          lines(points, markers.colours[i], parts.paths, 0.7);
        }
      }
    }

    // Pyramids that stay small beside the scene however far away the cameras stand.
    for (const camera of data.cameras) {
      const tip = vector(camera.centre);
      const [a, b, c, d] = camera.corners.map((v) => vector(v).multiplyScalar(0.13 * size).add(tip));
      const roof = a.clone().add(b).multiplyScalar(0.5).add(a.clone().sub(d).multiplyScalar(0.25)); // what is up in the picture
      lines([tip, a, tip, b, tip, c, tip, d, a, b, b, c, c, d, d, a, a, roof, roof, b], 0x5d6570, parts.cameras);
      labels.push({ kind: "camera", part: parts.cameras, name: camera.name, at: () => tip.clone() });
    }

    // The floor: under everything that stands there, at height 0 where that is near.
    const step = round(size / 8), half = Math.ceil(size / step) * step;
    const floor = standing && low.y >= -0.02 * size && low.y < 0.6 * size ? 0 : low.y - 0.02 * size;

    if (data.axis) {
      const point = vector(data.axis.point), direction = vector(data.axis.direction).normalize();
      const along = (v) => v.clone().sub(point).dot(direction);
      const back = new T.Matrix4().copy(turn).transpose();
      const middle = standing ? along(centre.clone().applyMatrix4(back)) : 0;
      const on = (t) => point.clone().addScaledVector(direction, middle + t * size);
      // The foot stands on the floor where the axis meets it nearby.
      const rise = direction.clone().applyMatrix4(turn).y;
      const fall = rise > 0.5 ? (floor - upright(on(0)).y) / (rise * size) : -0.5;
      const foot = Math.abs(fall) < 1.5 ? fall : -0.5;
      const side = new T.Vector3(1, 0, 0).projectOnPlane(direction);
      if (side.length() < 0.1) side.set(0, 0, 1).projectOnPlane(direction);
      side.normalize();
      const tip = on(0.75), barb = (s) => on(0.71).addScaledVector(side, 0.012 * s * size);
      const ring = [];
      for (let i = 0; i < 96; i++) {
        const spoke = (k) => side.clone().applyAxisAngle(direction, (k * Math.PI) / 48).multiplyScalar(0.3 * size).add(on(foot));
        ring.push(spoke(i), spoke(i + 1));
      }
      lines([on(foot), tip, tip, barb(1), tip, barb(-1), ...ring], 0xc1440e, parts.axis);
      labels.push({ kind: "axis", part: parts.axis, name: "turning axis", at: () => tip.clone() });
    }

    const snap = (x) => Math.round(x / step) * step;
    const grid = [];
    for (let t = -half; t <= half + step / 2; t += step) {
      const x = snap(centre.x), z = snap(centre.z);
      grid.push(new T.Vector3(x + t, floor, z - half), new T.Vector3(x + t, floor, z + half));
      grid.push(new T.Vector3(x - half, floor, z + t), new T.Vector3(x + half, floor, z + t));
    }
    parts.grid = new T.Group();
    root.add(parts.grid);
    lines(grid, 0x9aa7b5, parts.grid, 0.5);

    // Where labels would cover each other, the first keeps its place.
    const rank = ["marker", "joint", "axis", "camera"];
    labels.sort((a, b) => rank.indexOf(a.kind) - rank.indexOf(b.kind));

    return { world, parts, labels, markers, joints, size, centre, step,
      show: (frame) => { if (data.frames.length) for (const update of updates) update(frame); },
      enlarge: (factor) => { enlarged = factor; } };
  };

  // By how much standard deviations are enlarged at first, so that they reach beyond the ball that shows the marker.
  const enlargement = (scene) => {
    const known = scene.markers && scene.markers.sigma ? scene.markers.sigma.filter((s) => s > 0).sort() : [];
    if (!known.length) return 0;
    const middle = known[Math.floor(known.length / 2)];
    return [1, 3, 10, 30, 100, 300].find((factor) => factor * middle > 0.02 * scene.size) || 1000;
  };

  const start = (element) => {
    const data = JSON.parse(element.querySelector("script").textContent);
    const probe = document.createElement("canvas").getContext("webgl2");
    const root = new T.Scene(), scene = build(data, root), { parts } = scene;
    let frame = 0, playing = false, dirty = true;
    const canvas = make("canvas", element, { tabIndex: 0 });
    canvas.setAttribute("aria-label", `${data.title}: drag or use the arrow keys to turn`);
    const layer = make("div", element, { className: "labels" });

    const card = make("details", element, { className: "panel about", open: element.clientWidth > 640 });
    make("h1", make("summary", card), { textContent: data.title });
    const about = make("div", card);
    const counted = [data.markers && plural(data.markers.names.length, "marker"),
      data.skeleton && plural(data.skeleton.names.length, "joint"), data.cameras.length && plural(data.cameras.length, "camera"),
      data.frames.length > 1 && plural(data.frames.length, "frame")].filter(Boolean).join(", ");
    const unit = data.unit ? ` ${data.unit}` : "";
    const grid = `squares of ${Number(scene.step.toPrecision(2))}${unit || " (no physical unit)"}`;
    make("p", about, { className: "soft", textContent: [counted, grid].filter(Boolean).join(" · ") });
    for (const note of data.notes) make("p", about, { className: "soft", textContent: note });
    const switches = { markers: data.markers, skeleton: data.skeleton, cameras: data.cameras.length, axis: data.axis,
      paths: data.markers && data.frames.length > 1, 
      names: scene.labels.length, "joint names": data.skeleton && data.markers, grid: true };
    const shown = {};
    for (const [name, there] of Object.entries(switches)) {
      if (!there) continue;
      const label = make("label", about);
      const box = make("input", label, { type: "checkbox", checked: name !== "paths" && name !== "joint names" });
      label.append(name);
      const apply = () => { shown[name] = box.checked; if (parts[name]) parts[name].visible = box.checked; dirty = true; };
      box.addEventListener("change", apply);
      apply();
    }
    if (scene.markers && scene.markers.sigma) {
      const label = make("label", about, { textContent: "standard deviation " });
      const select = make("select", label);
      const first = enlargement(scene);
      for (const [factor, text] of [[0, "hidden"], [1, "true size"], ...[3, 10, 30, 100, 300, 1000].map((f) => [f, `× ${f}`])]) {
        make("option", select, { value: factor, textContent: text, selected: factor === first });
      }
      const apply = () => { scene.enlarge(Number(select.value)); scene.show(frame); dirty = true; };
      select.addEventListener("change", apply);
      apply();
    }
    make("p", about, { className: "soft", textContent: "Drag or arrow keys turn, wheel or + − zoom, right button moves, R resets." });

    const tables = [["marker", scene.markers], ["joint", scene.joints]].filter(([, track]) => track && track.names.length);
    const cells = [];
    if (tables.length && data.frames.length) {
      const panel = make("details", element, { className: "panel numbers" });
      make("summary", panel, { textContent: `Coordinates${data.unit ? ` [${data.unit}]` : ""}` });
      for (const [word, track] of tables) {
        const table = make("table", panel), head = make("tr", make("thead", table)), body = make("tbody", table);
        for (const title of [word, "x", "y", "z"]) make("th", head, { textContent: title });
        track.names.forEach((name, i) => {
          const row = make("tr", body), first = make("td", row);
          if (track.colours) make("i", first).style.background = track.colours[i];
          first.append(name);
          cells.push({ track, i, nodes: [0, 1, 2].map(() => make("td", row)) });
        });
      }
      panel.addEventListener("toggle", () => { fill(); });
    }
    const fill = () => {
      const digits = Math.max(0, Math.min(6, 4 - Math.ceil(Math.log10(scene.size))));
      for (const { track, i, nodes } of cells) {
        nodes.forEach((node, axis) => {
          const k = 3 * (frame * track.names.length + i) + axis, value = track.p[k], sigma = track.sigma && track.sigma[k];
          const spread = Number.isFinite(sigma) ? ` ± ${Number(sigma.toPrecision(2))}` : "";
          node.textContent = Number.isFinite(value) ? value.toFixed(digits) + spread : "not seen";
        });
      }
    };

    const tags = scene.labels.map((label) => make("span", layer, { className: label.kind, textContent: label.name }));
    const show = (next) => { frame = next; scene.show(frame); if (element.querySelector(".numbers[open]")) fill(); dirty = true; };
    show(0);
    fill();
    timeline();

    if (!probe) {
      canvas.remove();
      const text = "This browser offers no WebGL 2, so the picture cannot be drawn. " +
        (cells.length ? "The coordinates are in the table. " : "") + "Try another browser, or switch on hardware acceleration.";
      make("p", element, { className: "panel problem", textContent: text });
      for (const details of element.querySelectorAll("details")) details.open = true; // the numbers are what there is
      return;
    }
    const renderer = new T.WebGLRenderer({ canvas, antialias: true, alpha: true });
    root.add(new T.HemisphereLight(0xffffff, 0x8d99a8, 2.2));
    const camera = new T.PerspectiveCamera(35, 1, scene.size / 1000, scene.size * 100);
    const lamp = new T.DirectionalLight(0xffffff, 1.6);
    root.add(lamp, lamp.target);
    const controls = new T.OrbitControls(camera, canvas);
    controls.addEventListener("change", () => { dirty = true; });

    const turnTo = (azimuth, polar, distance) => {
      const s = new T.Spherical(distance, Math.min(Math.max(polar, 0.02), Math.PI - 0.02), azimuth);
      camera.position.setFromSpherical(s).add(controls.target);
      controls.update();
      dirty = true;
    };
    const reset = () => {
      controls.target.copy(scene.centre);
      turnTo(0.5, 1.3, (0.62 * scene.size) / Math.tan((Math.PI / 180) * 17.5) / Math.min(1, camera.aspect));
    };
    const keys = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    element.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input[type=range], select")) return;
      press(event);
    });
    // In a page of its own the arrow keys work before anything has been clicked. Among other things on a page the
    // wheel scrolls the page until the picture has been clicked.
    if (!document.querySelector("body > :not(.jaxmocap-viewer, script)")) {
      window.addEventListener("keydown", (event) => { if (event.target === document.body) press(event); });
    } else {
      controls.enableZoom = false;
      canvas.addEventListener("focus", () => { controls.enableZoom = true; });
      canvas.addEventListener("blur", () => { controls.enableZoom = false; });
    }
    function press(event) {
      const offset = camera.position.clone().sub(controls.target);
      const s = new T.Spherical().setFromVector3(offset), step = Math.PI / 36;
      if (keys[event.key]) turnTo(s.theta + step * keys[event.key][0], s.phi + step * keys[event.key][1], s.radius);
      else if (event.key === "+" || event.key === "=") turnTo(s.theta, s.phi, s.radius / 1.12);
      else if (event.key === "-") turnTo(s.theta, s.phi, s.radius * 1.12);
      else if (event.key === "r" || event.key === "R") reset();
      else return;
      event.preventDefault();
    }

    const resize = () => {
      const { clientWidth: w, clientHeight: h } = element;
      if (!w || !h) return;
      renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
      renderer.setSize(w, h, false);
      camera.aspect = w / h;
      camera.updateProjectionMatrix();
      dirty = true;
    };
    new ResizeObserver(resize).observe(element);
    resize();
    reset();

    const place = () => {
      const { clientWidth: w, clientHeight: h } = element, taken = [];
      scene.labels.forEach((label, i) => {
        const v = scene.world.localToWorld(label.at(frame)).project(camera);
        const wanted = shown.names && (label.kind !== "joint" || !data.markers || shown["joint names"]);
        const visible = wanted && label.part.visible && Number.isFinite(v.x) && Math.abs(v.z) < 1;
        const x = ((v.x + 1) / 2) * w + 8, y = ((1 - v.y) / 2) * h - 7;
        // A label that would lie on one placed before it is left out.
        const free = visible && !taken.some((o) => Math.abs(o.y - y) < 14 && x < o.x + o.w && o.x < x + tagWidth(i));
        tags[i].style.visibility = free ? "visible" : "hidden";
        if (!free) return;
        taken.push({ x, y, w: tagWidth(i) });
        tags[i].style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
      });
    };
    const widths = [];
    const tagWidth = (i) => (widths[i] ??= tags[i].offsetWidth + 2);

    const draw = () => {
      requestAnimationFrame(draw);
      if (!dirty) return;
      dirty = false;
      lamp.position.copy(camera.position).add(new T.Vector3(-0.4, 0.8, 0).multiplyScalar(scene.size));
      lamp.target.position.copy(controls.target);
      renderer.render(root, camera);
      place();
      element.dataset.drawn = String(Number(element.dataset.drawn || 0) + 1);
    };
    draw();

    function timeline() {
      const n = data.frames.length;
      if (n < 2) return;
      const bar = make("div", element, { className: "panel time" });
      const button = make("button", bar, { type: "button", textContent: "Play" });
      const slider = make("input", bar, { type: "range", min: 0, max: n - 1, value: 0 });
      slider.setAttribute("aria-label", "frame");
      const output = make("output", bar);
      const go = (next) => {
        show(next);
        slider.value = next;
        const seconds = data.fps ? ` · ${(data.frames[next] / data.fps).toFixed(3)} s` : "";
        output.textContent = `frame ${data.frames[next]}${seconds}`;
      };
      slider.addEventListener("input", () => go(Number(slider.value)));
      let begun = 0, from = 0;
      const tick = (now) => {
        if (!playing) return;
        const next = (from + Math.floor(((now - begun) / 1000) * (data.fps || 25))) % n;
        if (next !== frame) go(next);
        requestAnimationFrame(tick);
      };
      button.addEventListener("click", () => {
        playing = !playing;
        button.textContent = playing ? "Pause" : "Play";
        begun = performance.now();
        from = frame;
        if (playing) requestAnimationFrame(tick);
      });
      go(0);
    }
  };

  for (const element of document.querySelectorAll(".jaxmocap-viewer")) start(element);
})();
