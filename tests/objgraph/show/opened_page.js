// A map's page without a browser: what it draws when it opens, by its own three.js. Prints how many boxes are in the picture,
// and how many there are.
const vm = require("vm");
const page = require("fs").readFileSync(process.argv[2], "utf8");
const [data, three, script] = [...page.matchAll(/<script[^>]*>([^]*?)<\/script>/g)].map((found) => found[1]);
const anything = () =>
  new Proxy(function () {}, {
    get(known, name) {
      if (name === Symbol.toPrimitive) return () => "";
      if (name === "clientWidth") return 1400;
      if (name === "clientHeight") return 1000;
      return name === "prototype" || name in known ? known[name] : (known[name] = anything());
    },
    apply: anything,
  });
const [canvas, source] = [anything(), { textContent: data }];
globalThis.window = anything();
globalThis.document = anything();
document.getElementById = (id) => (id === "data" ? source : id === "canvas" ? canvas : anything());
globalThis.ResizeObserver = class { constructor(told) { this.told = told; } observe() { this.told(); } };
vm.runInThisContext(three);
const { OrbitControls, WebGLRenderer, ...kept } = THREE;
let drawn;
const renderer = { setPixelRatio() {}, setClearColor() {}, setSize() {}, clear() {}, clearDepth() {}, render(scene, camera) { drawn = [scene, camera]; } };
const looked = class { constructor(camera) { this.camera = camera; this.target = new kept.Vector3(); } addEventListener() {} update() { this.camera.lookAt(this.target); } };
const own = { ...kept, WebGLRenderer: class { constructor() { return renderer; } }, OrbitControls: looked };
vm.runInThisContext(`THREE => { ${script} }`)(own);
const [scene, camera] = drawn;
camera.updateMatrixWorld(true);
scene.updateMatrixWorld(true);
const places = [];
scene.traverse((each) => each.isLineSegments && places.push(new kept.Vector3().applyMatrix4(each.matrixWorld).project(camera)));
console.log(JSON.stringify([places.filter(({ x, y, z }) => Math.max(Math.abs(x), Math.abs(y), Math.abs(z)) <= 1).length, places.length]));
