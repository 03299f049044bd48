"use strict";
const report = JSON.parse(document.getElementById("data").textContent);
const byId = new Map(report.objects.map((object) => [object.id, object]));
const scenes = startMap();
let chosen = null;

document.querySelector("h1").textContent = report.title;
document.getElementById("about").textContent =
  `${report.mapped} of ${report.objects.length} objects mapped. Ellipsoids hold the box's centre with ` +
  `${Math.round(100 * report.level)} % by its covariance. ` +
  (report.errors ? `From “${report.errors}” on: errors against the scan's ground truth. ` : "") + `objgraph ${report.program}.`;
fillTable();
if (report.sigma) {
  const scale = document.getElementById("scale");
  scale.hidden = false;
  scale.append("standard deviation of the surface");
  const bar = document.createElement("i");
  bar.style.background = `linear-gradient(to right, ${report.sigma.colors.join(",")})`;
  const ends = document.createElement("span");
  for (const text of ["0", `${report.sigma.limit_cm.toFixed(1)} cm`]) ends.append(element("span", text));
  scale.append(bar, ends);
}

function element(name, text) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  return made;
}

function shownValue(value, column) {
  if (value === null || value === undefined) return "-";
  return typeof value === "number" ? value.toFixed(column.digits) : value;
}

function fillTable() {
  const head = document.createElement("tr");
  for (const column of report.columns) {
    const cell = element("th");
    const button = element("button", column.label);
    button.addEventListener("click", () => sortBy(column.key, cell));
    cell.append(button);
    if (column.unit) cell.append(" ", element("small", column.unit));
    head.append(cell);
  }
  document.querySelector("thead").append(head);
  for (const object of report.objects) {
    const row = element("tr");
    row.dataset.id = object.id;
    row.tabIndex = 0;
    row.classList.toggle("failed", !object.mapped);
    for (const column of report.columns) row.append(element("td", shownValue(object.row[column.key], column)));
    row.addEventListener("click", () => choose(object.id, true));
    row.addEventListener("keydown", (event) => event.key === "Enter" && choose(object.id, true));
    document.querySelector("tbody").append(row);
  }
}

function sortBy(key, cell) {
  const falling = cell.getAttribute("aria-sort") === "ascending";
  for (const other of document.querySelectorAll("th")) other.removeAttribute("aria-sort");
  cell.setAttribute("aria-sort", falling ? "descending" : "ascending");
  const body = document.querySelector("tbody");
  const value = (row) => byId.get(Number(row.dataset.id)).row[key];
  const known = (x) => x !== null && x !== undefined;
  const rows = [...body.rows].sort((a, b) => {
    const [x, y] = [value(a), value(b)];
    if (!known(x) || !known(y)) return known(y) - known(x);
    const order = typeof x === "number" ? x - y : String(x).localeCompare(String(y), undefined, { numeric: true });
    return falling ? -order : order;
  });
  body.append(...rows);
}

function choose(id, fly) {
  chosen = id;
  const object = byId.get(id);
  document.body.dataset.chosen = id;
  for (const row of document.querySelectorAll("tbody tr")) row.classList.toggle("chosen", Number(row.dataset.id) === id);
  const panel = document.getElementById("object");
  panel.replaceChildren(element("h2", object.name));
  for (const remark of object.remarks) {
    const line = element("p", remark);
    line.className = "remark";
    panel.append(line);
  }
  const facts = element("dl");
  for (const column of report.columns.slice(1)) {
    facts.append(element("dt", column.label), element("dd", `${shownValue(object.row[column.key], column)} ${column.unit}`));
  }
  panel.append(facts);
  const views = element("div");
  views.id = "views";
  for (const view of object.views) {
    const figure = element("figure");
    const image = element("img");
    image.src = `data:image/jpeg;base64,${view.jpeg}`;
    image.alt = `${object.name} in frame ${view.frame}`;
    figure.append(image, element("figcaption", `frame ${view.frame}`));
    views.append(figure);
  }
  panel.append(views);
  if (object.views.length) panel.append(element("p", "Orange: the estimate's outline. Blue: the mask's."));
  panel.scrollTop = 0;
  if (scenes) scenes.choose(id, fly);
}

function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

function startMap() {
  const canvas = document.getElementById("canvas");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  } catch (error) {
    document.getElementById("no-webgl").hidden = false;
    document.getElementById("shown").hidden = true;
    return null;
  }
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  renderer.setClearColor(0xffffff);
  renderer.autoClear = false;
  const scene = new THREE.Scene();
  const cloud = new THREE.Scene();
  const up = new THREE.Vector3(...report.up);
  const sky = new THREE.HemisphereLight(0xffffff, 0x9a9a9a, 2.2);
  sky.position.copy(up);
  const lamp = new THREE.DirectionalLight(0xffffff, 1.2);
  scene.add(sky);
  const camera = new THREE.PerspectiveCamera(45, 1, 0.02, 500);
  camera.up.copy(up);
  camera.add(lamp);
  lamp.position.set(-1, 2, 1);
  scene.add(camera);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.addEventListener("change", draw);
  const layers = {};
  for (const name of ["points", "meshes", "boxes", "ellipsoids", "modes"]) {
    layers[name] = new THREE.Group();
    (name === "points" ? cloud : scene).add(layers[name]);
  }
  const names = new Map();
  const meshes = new Map();
  const whole = new THREE.Box3();
  addPoints();
  for (const object of report.objects) {
    if (object.box) addLines(object);
    if (object.ellipsoid) addEllipsoid(object);
    if (object.mesh) addMesh(object);
  }
  // a street is larger than a room, and a chair in it is looked at from as near
  camera.far = Math.max(camera.far, 4 * whole.getSize(new THREE.Vector3()).length());
  camera.near = Math.min(camera.far / 25000, 0.2);
  const form = document.getElementById("shown");
  const apply = () => {
    for (const name in layers) layers[name].visible = form.elements[name].checked;
    for (const label of names.values()) label.hidden = !form.elements.names.checked;
    draw();
  };
  form.addEventListener("change", apply);
  document.getElementById("whole").addEventListener("click", () => {
    stress(null);
    look(whole);
  });
  new ResizeObserver(resize).observe(canvas.parentElement);
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  canvas.addEventListener("pointerup", (event) => {
    if (pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 5) pick(event);
    pressed = null;
  });
  apply();

  function addPoints() {
    if (!report.points) return;
    const geometry = new THREE.BufferGeometry();
    const positions = new Float32Array(bytes(report.points.positions).buffer);
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setAttribute("color", linear(bytes(report.points.colors)));
    layers.points.add(new THREE.Points(geometry, new THREE.PointsMaterial({ size: 0.015, vertexColors: true })));
  }

  // colours are given as screens have them, WebGL mixes them as light is
  function linear(values, size = 3) {
    const known = new THREE.BufferAttribute(new Float32Array((values.length / size) * 3), 3);
    const color = new THREE.Color();
    for (let i = 0; i < known.count; i++) {
      color.setRGB(values[size * i] / 255, values[size * i + 1] / 255, values[size * i + 2] / 255).convertSRGBToLinear();
      known.setXYZ(i, color.r, color.g, color.b);
    }
    return known;
  }

  function addLines(object) {
    const edges = new THREE.EdgesGeometry(new THREE.BoxGeometry(1, 1, 1));
    const lines = new THREE.LineSegments(edges, new THREE.LineBasicMaterial({ color: 0x6e7781 }));
    place(lines, object.box);
    lines.userData.id = object.id;
    layers.boxes.add(lines);
    lines.geometry.computeBoundingBox();
    const box = lines.geometry.boundingBox.clone().applyMatrix4(lines.matrix);
    whole.union(box);
    const label = element("span", object.name);
    label.className = "name";
    label.addEventListener("click", () => choose(object.id, false));
    canvas.parentElement.append(label);
    const top = box.getCenter(new THREE.Vector3());
    const size = box.getSize(new THREE.Vector3());
    const height = Math.abs(size.x * up.x) + Math.abs(size.y * up.y) + Math.abs(size.z * up.z);
    label.at = top.addScaledVector(up, height / 2 + 0.03);
    names.set(object.id, label);
  }

  function addEllipsoid(object) {
    const material = new THREE.MeshBasicMaterial({ color: 0xd55e00, transparent: true, opacity: 0.55, depthTest: false });
    const ball = new THREE.Mesh(new THREE.SphereGeometry(1, 24, 16), material);
    ball.renderOrder = 2;
    place(ball, object.ellipsoid);
    layers.ellipsoids.add(ball);
  }

  function addMesh(object) {
    new THREE.GLTFLoader().parse(bytes(object.mesh).buffer, "", (loaded) => {
      const parts = [];
      loaded.scene.traverse((part) => part.isMesh && parts.push(part));
      for (const part of parts) {
        const geometry = part.geometry;
        if (geometry.attributes.color) {
          const given = geometry.attributes.color;
          const values = new Uint8Array(given.array.length);
          const factor = given.array instanceof Uint8Array ? 1 : given.array instanceof Uint16Array ? 1 / 257 : 255;
          given.array.forEach((value, i) => (values[i] = Math.round(factor * value)));
          geometry.setAttribute("color", linear(values, given.itemSize));
        }
        if (!geometry.attributes.normal) geometry.computeVertexNormals();
        const material = new THREE.MeshStandardMaterial({
          vertexColors: Boolean(geometry.attributes.color), roughness: 0.85, side: THREE.DoubleSide,
        });
        const mesh = new THREE.Mesh(geometry, material);
        mesh.userData.id = object.id;
        layers.meshes.add(mesh);
        meshes.set(object.id, mesh);
        for (const mode of object.modes) {
          const faint = new THREE.MeshStandardMaterial({
            color: 0x0072b2, transparent: true, opacity: 0.12 + 0.4 * mode.probability, depthWrite: false,
          });
          const ghost = new THREE.Mesh(geometry, faint);
          place(ghost, mode.matrix);
          ghost.visible = false;
          ghost.userData.id = object.id;
          layers.modes.add(ghost);
        }
      }
      draw();
    }, (error) => console.error(object.name, error));
  }

  function place(thing, matrix) {
    thing.matrixAutoUpdate = false;
    thing.matrix.fromArray(matrix);
  }

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (!resize.done && !whole.isEmpty()) look(whole);
    resize.done = true;
    draw();
  }

  function look(box, direction) {
    const middle = box.getCenter(new THREE.Vector3());
    const radius = box.getSize(new THREE.Vector3()).length() / 2;
    const level = new THREE.Vector3(1, 0.3, 0.2).projectOnPlane(up).normalize();
    const from = direction || level.addScaledVector(up, 0.75).normalize();
    const half = Math.atan(Math.tan((camera.fov * Math.PI) / 360) * Math.min(camera.aspect, 1));
    camera.position.copy(middle).addScaledVector(from, (1.05 * radius) / Math.sin(half));
    controls.target.copy(middle);
    controls.update();
    draw();
  }

  function pick(event) {
    const frame = canvas.getBoundingClientRect();
    const place = new THREE.Vector2(
      (2 * (event.clientX - frame.left)) / frame.width - 1, 1 - (2 * (event.clientY - frame.top)) / frame.height,
    );
    const caster = new THREE.Raycaster();
    caster.setFromCamera(place, camera);
    const [hit] = caster.intersectObjects(layers.meshes.children, false);
    if (hit) window.choose(hit.object.userData.id, false);
  }

  function draw() {
    // points never hide an estimate: both stand for the same thing
    renderer.clear();
    renderer.render(cloud, camera);
    renderer.clearDepth();
    renderer.render(scene, camera);
    const { clientWidth: width, clientHeight: height } = canvas;
    for (const label of names.values()) {
      const at = label.at.clone().project(camera);
      label.style.display = at.z < 1 ? "" : "none";
      label.style.transform = `translate(-50%, -100%) translate(${((at.x + 1) / 2) * width}px, ${((1 - at.y) / 2) * height}px)`;
    }
  }

  // the others fade
  function stress(id) {
    for (const [other, mesh] of meshes) {
      const faint = id !== null && other !== id;
      Object.assign(mesh.material, { transparent: faint, opacity: faint ? 0.45 : 1, depthWrite: !faint, needsUpdate: true });
    }
    for (const ghost of layers.modes.children) ghost.visible = ghost.userData.id === id;
    for (const lines of layers.boxes.children) lines.material.color.setHex(lines.userData.id === id ? 0xd55e00 : 0x6e7781);
    for (const [other, label] of names) label.classList.toggle("chosen", other === id);
  }

  return {
    choose(id, fly) {
      stress(id);
      const mesh = meshes.get(id);
      if (fly && mesh) {
        mesh.geometry.computeBoundingBox();
        const box = mesh.geometry.boundingBox.clone();
        look(box.expandByScalar(0.3), camera.position.clone().sub(controls.target).normalize());
      }
      draw();
    },
    // a place on the page where a click hits this object, once it is drawn
    where(id) {
      const mesh = meshes.get(id);
      if (!mesh || !resize.done) return null;
      const caster = new THREE.Raycaster();
      const frame = canvas.getBoundingClientRect();
      const { position } = mesh.geometry.attributes;
      const corner = new THREE.Vector3();
      const { index } = mesh.geometry;
      for (let i = 0; i + 2 < index.count; i += 3) {
        const seen = new THREE.Vector3();
        for (const k of [i, i + 1, i + 2]) seen.addScaledVector(corner.fromBufferAttribute(position, index.getX(k)), 1 / 3);
        seen.project(camera);
        caster.setFromCamera(new THREE.Vector2(seen.x, seen.y), camera);
        const [hit] = caster.intersectObjects(layers.meshes.children, false);
        const x = frame.left + ((seen.x + 1) / 2) * frame.width;
        const y = frame.top + ((1 - seen.y) / 2) * frame.height;
        if (hit && hit.object === mesh && document.elementFromPoint(x, y) === canvas) return [x, y];
      }
      return null;
    },
  };
}
