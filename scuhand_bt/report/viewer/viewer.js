// The cell in 3D, by Three.js: one scene for every page that shows the arm.
//
// scene: {joints: [{at, axis}], solids: [{name, kind, joint, at, points, triangles, edges}], cones: [{mm, solids}] by rising mm,
// containers: [{name, solids}], places: [{name, at}], dots: [{at, tone}], home, apex}. Lengths in metres; `at` is x, y, z and a quaternion x, y, z, w; a solid's
// joint is counted from 1, 0 for what stands still. Joint angles in radians.

import * as THREE from "./three/three.module.min.js";
import {OrbitControls} from "./three/OrbitControls.js";

const COLOURS = {arm: 0x6f8fc0, hand: 0xd6a35a, cone: 0xf08c1e, standing: 0x8496a8, vessel: 0x3f8f7a, good: 0x0072b2, bad: 0xd55e00};

function placed(object, [x, y, z, ...turn]) {
  object.position.set(x, y, z);
  if (turn.length) object.quaternion.set(...turn);
  return object;
}

function solid({kind, at, points, triangles, edges}) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  geometry.setIndex(triangles);
  const stands = kind === "standing";
  const material = new THREE.MeshLambertMaterial({
    color: COLOURS[kind], flatShading: true, side: THREE.DoubleSide, transparent: stands, opacity: stands ? 0.28 : 1, depthWrite: !stands});
  const mesh = placed(new THREE.Mesh(geometry, material), at);
  if (edges.length) {
    const lines = new THREE.BufferGeometry();
    lines.setAttribute("position", geometry.getAttribute("position"));
    lines.setIndex(edges);
    mesh.add(new THREE.LineSegments(lines, new THREE.LineBasicMaterial({color: stands ? COLOURS.standing : 0x333a44})));
  }
  return mesh;
}

function label(text, at) {
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  canvas.width = 512; canvas.height = 64;
  pen.font = "600 40px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.lineWidth = 8; pen.strokeStyle = "#ffffffd0"; pen.strokeText(text, 256, 46);
  pen.fillStyle = "#1b6b3a"; pen.fillText(text, 256, 46);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({map, depthTest: false}));
  sprite.scale.set(0.32, 0.04, 1);
  sprite.renderOrder = 1;  // over what is seen through
  return placed(sprite, [at[0], at[1], at[2] + 0.02]);
}

export function view(holder, scene, text) {
  const renderer = new THREE.WebGLRenderer({antialias: true, alpha: true});
  const world = new THREE.Scene(), camera = new THREE.PerspectiveCamera(38, 1, 0.02, 20);
  camera.up.set(0, 0, 1);
  camera.position.set(0.81, -0.69, 0.56);
  world.add(new THREE.HemisphereLight(0xffffff, 0x8a93a0, 2.2));
  world.add(placed(new THREE.DirectionalLight(0xffffff, 1.6), [1, -2, 3]));
  const joints = [world];
  for (const {at} of scene.joints) {
    const fixed = placed(new THREE.Group(), at), turning = new THREE.Group();
    joints[joints.length - 1].add(fixed);
    fixed.add(turning);
    joints.push(turning);
  }
  for (const one of scene.solids) joints[one.joint].add(solid(one));
  // One cone is drawn; every width has the same points, and what lies between two widths lies between their points.
  const sheet = scene.cones[0].solids.map((one) => solid(one));
  joints[joints.length - 1].add(...sheet);
  for (const mesh of sheet) mesh.frustumCulled = false;
  const form = (mm) => {
    const cones = scene.cones;
    const k = Math.max(0, cones.findLastIndex((one) => one.mm <= mm)), wider = cones[Math.min(k + 1, cones.length - 1)];
    const part = wider.mm > cones[k].mm ? Math.min(1, Math.max(0, (mm - cones[k].mm) / (wider.mm - cones[k].mm))) : 0;
    sheet.forEach((mesh, number) => {
      const narrow = cones[k].solids[number], wide = wider.solids[number], points = mesh.geometry.getAttribute("position");
      points.copyArray(narrow.points.map((one, i) => one + part * (wide.points[i] - one)));
      points.needsUpdate = true;
      placed(mesh, between(narrow.at, wide.at, part));
      mesh.quaternion.normalize();
    });
  };
  const containers = scene.containers.map(({name, solids}) => {
    const group = new THREE.Group();
    for (const one of solids) group.add(solid({...one, kind: "vessel"}));
    world.add(group);
    group.visible = false;
    return {name, group};
  });
  for (const {name, at} of scene.places) world.add(label(name, at));
  const dot = new THREE.SphereGeometry(0.006, 8, 6);
  for (const tone of ["good", "bad"]) {
    const some = (scene.dots ?? []).filter((one) => one.tone === tone);
    const dots = new THREE.InstancedMesh(dot, new THREE.MeshLambertMaterial({color: COLOURS[tone], transparent: true, opacity: 0.6}), some.length);
    some.forEach(({at}, k) => dots.setMatrixAt(k, new THREE.Matrix4().setPosition(...at)));
    if (some.length) world.add(dots);
  }
  const tip = placed(new THREE.Object3D(), scene.apex);
  joints[joints.length - 1].add(tip);
  const way = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({color: 0xc0392b}));
  way.frustumCulled = false;
  world.add(way);

  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", text);
  holder.replaceChildren(canvas);
  const controls = new OrbitControls(camera, canvas);
  controls.target.set(0.18, -0.02, 0.16);
  if (scene.dots?.length) camera.position.multiplyScalar(1.5);  // they reach farther than the cell
  controls.listenToKeyEvents(canvas);
  let isAsked = false;
  const draw = () => {
    if (isAsked) return;
    isAsked = true;
    requestAnimationFrame(() => { isAsked = false; renderer.render(world, camera); });
  };
  const fit = () => {
    const wide = holder.clientWidth, high = holder.clientHeight;
    if (!wide || !high) return;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    renderer.setSize(wide, high, false);
    camera.aspect = wide / high;
    camera.fov = 2 * THREE.MathUtils.RAD2DEG * Math.atan(0.344 * Math.max(1, 1.35 / camera.aspect));  // the cell's width fits
    camera.updateProjectionMatrix();
    draw();
  };
  controls.addEventListener("change", draw);
  controls.update();
  new ResizeObserver(fit).observe(holder);

  const axes = scene.joints.map(({axis}) => new THREE.Vector3(...axis));
  const turn = (q) => axes.forEach((axis, k) => joints[k + 1].quaternion.setFromAxisAngle(axis, q[k]));
  const where = () => { world.updateMatrixWorld(); return tip.getWorldPosition(new THREE.Vector3()); };
  return {
    pose(q) { turn(q); draw(); },
    // The cone with a rim of this diameter.
    cone(mm) { form(mm); draw(); },
    // Arm and cone as they are at a time of a motion that began at its `at_s`.
    at(move, time_s) { turn(at(move, time_s, move.joints_rad)); form(rimAt(move, time_s)); draw(); },
    // What stands on the pan, by the name of its kind.
    pan(name) {
      for (const one of containers) one.group.visible = one.name === name;
      draw();
    },
    apex() { return where().toArray(); },
    // The diameter of the rim that is drawn [mm].
    rim() {
      const box = new THREE.Box3().setFromBufferAttribute(sheet[sheet.length - 1].geometry.getAttribute("position"));
      return 1000 * (box.max.x - box.min.x);
    },
    // The way of the cone's apex along these configurations; the arm is left at the last.
    path(rows) {
      way.geometry.dispose();
      way.geometry = new THREE.BufferGeometry().setFromPoints(rows.map((q) => { turn(q); return where(); }));
      draw();
    },
  };
}

const between = (a, b, part) => a.map((one, i) => one + part * (b[i] - one));

// What a motion's rows, which are lists, say of a time of it.
function at(move, time_s, rows) {
  const place = Math.max(0, Math.min((time_s - move.at_s) / move.step_s, rows.length - 1));
  const k = Math.floor(place);
  return k + 1 < rows.length ? between(rows[k], rows[k + 1], place - k) : rows[k];
}

const rimAt = (move, time_s) => move.rims_mm?.length ? at(move, time_s, move.rims_mm.map((mm) => [mm]))[0] : move.cone_mm;

export const lasts = (move) => move.step_s * (Math.max(move.joints_rad.length, move.rims_mm?.length ?? 0) - 1);
