// What three.js is bundled from (three 0.187, MIT: THREE_LICENSE.txt), by
// npx esbuild three_entry.js --bundle --minify --format=iife --global-name=THREE --outfile=three.js
export {
  AmbientLight, Box3, BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, EdgesGeometry, BoxGeometry,
  HemisphereLight, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, PerspectiveCamera, Points,
  PointsMaterial, Raycaster, Scene, SphereGeometry, Vector2, Vector3, WebGLRenderer, Group, GridHelper,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
export { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
