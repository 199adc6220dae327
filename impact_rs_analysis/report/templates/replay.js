// SPDX-License-Identifier: Apache-2.0
// Runs in 3D: measured bodies solid, the model's as a ghost, contact forces and velocities as arrows.
//
//   const replay = new ImpactReplay(element, data, {onSeek: (time) => ...});   // data: report/animation.py
//   replay.show(number);   replay.seek(time);   replay.play();   replay.pause();
//
// One call moves everything: seek(time) places joints and object between the two nearest samples, and calls onSeek.
//
//   const live = new ImpactLive(element);
//   live.show(scene);   live.update({time, joints, object, neighbours, forces});   // scene: report/scene_3d.py
//
// shows the newest state of running nodes.
//
//   const picture = new ImpactPicture(element);
//   picture.show(scene);   picture.update({joints, object, neighbours, jumps});
//
// shows one moment, the impact, with the velocities before and after it and their intervals.
// Lengths are in m, times in s, z is up. Needs THREE, of three.min.js.
'use strict';

const {ImpactReplay, ImpactLive, ImpactPicture} = (function () {
  const GHOST = '#0072B2', FORCE = '#D55E00', BEFORE = '#E69F00', AFTER = '#009E73', OBJECT = '#C2995F';
  const LONGEST_ARROW = 0.25, SHORTEST_ARROW = 0.01;
  const SLOW_MOTION = 100;
  const MARGIN = 0.9;
  const STEP = 0.001, BIG_STEP = 0.01;
  const FULL = [20, 50, 100, 200, 500, 1000, 2000, 5000];  // N, possible forces of the longest arrow in a live picture
  const EMPTY = [[-0.5, -0.5, 0], [0.5, 0.5, 0.5]];  // m, corners of the view of an empty scene
  const ROOM = 0.1;  // m, margin of the view around everything that has moved so far
  const ABOVE = {before: 0.09, after: 0.06, model: 0.03};  // arrows of one direction would hide each other

  function floats(text) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }

  function element(tag, attributes, ...children) {
    const node = document.createElement(tag);
    Object.entries(attributes).forEach(([name, value]) => node.setAttribute(name, value));
    node.append(...children);
    return node;
  }

  function select(label, choices) {
    const node = element('select', {'aria-label': label});
    choices.forEach(([value, text]) => node.add(new Option(text, value)));
    return node;
  }

  function placed(node, origin) {
    node.position.fromArray(origin.position);
    node.quaternion.fromArray(origin.quaternion);
    return node;
  }

  function geometry(shape) {
    if (shape.kind === 'mesh') {
      const mesh = new THREE.BufferGeometry();
      mesh.setAttribute('position', new THREE.BufferAttribute(floats(shape.vertices), 3));
      mesh.setIndex(Array.from(floats(shape.faces)));
      const flat = mesh.toNonIndexed();
      flat.computeVertexNormals();
      return flat;
    }
    if (shape.kind === 'box') return new THREE.BoxGeometry(...shape.size);
    const [radius] = shape.radius;
    return new THREE.CylinderGeometry(radius, radius, shape.length[0], 32).rotateX(Math.PI / 2);
  }

  // Arms, support and objects of one side; a ghost has neither support nor colours of its own.
  class Bodies {
    constructor(scene, ghost) {
      this.root = new THREE.Group();
      this.links = {};
      this.joints = [];
      this.ghost = ghost;
      Object.entries(scene.links).forEach(([name, shapes]) => {
        this.links[name] = new THREE.Group();
        if (ghost && name === 'support') return;
        shapes.forEach((shape) => {
          const material = this.material(new THREE.Color().setRGB(...shape.colour, THREE.SRGBColorSpace));
          // The support is transparent, so that bodies below it are visible.
          if (name === 'support') Object.assign(material, {transparent: true, opacity: 0.35, depthWrite: false});
          this.links[name].add(placed(new THREE.Mesh(geometry(shape), material), shape));
        });
      });
      scene.joints.forEach((joint) => {
        const frame = placed(new THREE.Group(), joint);
        this.links[joint.parent].add(frame);
        frame.add(this.links[joint.child]);
        if (joint.column === undefined) return;
        const axis = new THREE.Vector3(...(joint.axis || [0, 0, 1]));
        this.joints[joint.column] = {type: joint.type, axis, link: this.links[joint.child]};
      });
      this.objects = [scene, ...(scene.neighbours || [])].map(({object, object_shape: shape}) => {
        const body = shape ? geometry(shape) : new THREE.BoxGeometry(...(object || [0, 0, 0]));  // no object is known
        return new THREE.Mesh(body, this.material(new THREE.Color(OBJECT)));
      });
      this.root.add(this.links[scene.root], ...this.objects);
    }

    // A ghost is pushed back a little, so that it is seen only where it leaves the measured body.
    material(colour) {
      return this.ghost
        ? new THREE.MeshLambertMaterial({color: GHOST, transparent: true, opacity: 0.4, depthWrite: false,
                                         polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 2})
        : new THREE.MeshLambertMaterial({color: colour});
    }

    get object() {
      return this.objects[0];
    }

    // Poses of the object and its neighbours; null: not tracked.
    place(joints, poses) {
      this.joints.forEach((joint, column) => {
        if (joint.type === 'prismatic') joint.link.position.copy(joint.axis).multiplyScalar(joints[column]);
        else joint.link.quaternion.setFromAxisAngle(joint.axis, joints[column]);
      });
      this.objects.forEach((object, number) => {
        const pose = poses[number] || null;
        object.visible = pose !== null && Number.isFinite(pose[0]);
        if (!object.visible) return;
        object.position.fromArray(pose);
        object.quaternion.fromArray(pose, 3).normalize();
      });
    }

    // Extend bounds by the objects that are seen.
    expand(bounds, precise) {
      this.objects.filter((object) => object.visible).forEach((object) => bounds.expandByObject(object, precise));
    }

    positions() {
      this.root.updateMatrixWorld(true);
      return Object.fromEntries(Object.entries(this.links).map(([name, link]) =>
        [name, link.getWorldPosition(new THREE.Vector3()).toArray()]));
    }
  }

  // An arrow that nothing hides.
  class Arrow {
    constructor(colour, width) {
      const material = new THREE.MeshBasicMaterial({color: colour, depthTest: false, transparent: true});
      this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(width, width, 1, 12).translate(0, 0.5, 0), material);
      this.head = new THREE.Mesh(new THREE.ConeGeometry(2.5 * width, 6 * width, 16), material);
      this.headLength = 6 * width;
      this.root = new THREE.Group();
      this.root.add(this.shaft, this.head);
      this.root.renderOrder = this.shaft.renderOrder = this.head.renderOrder = 1;
    }

    set(start, vector) {
      const length = vector.length();
      this.root.visible = length > SHORTEST_ARROW;
      if (!this.root.visible) return;
      this.root.position.copy(start);
      this.root.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), vector.clone().normalize());
      const head = Math.min(this.headLength, length);
      this.shaft.visible = length > head;
      this.shaft.scale.y = Math.max(length - head, 1e-6);
      this.head.scale.y = head / this.headLength;
      this.head.position.y = length - head / 2;
    }
  }

  // A picture of a scene; the reader can turn it.
  class Stage {
    constructor(parent) {
      this.parent = parent;
      this.canvas = element('canvas', {tabindex: '0', role: 'img'});
      this.legend = element('ul', {class: 'plain replay-legend'});
      this.readout = element('p', {class: 'note replay-time'});
    }

    // Begin to draw on the canvas of the page.
    open() {
      try {
        this.renderer = new THREE.WebGLRenderer({canvas: this.canvas, antialias: true});
      } catch {
        this.canvas.replaceWith(element('p', {class: 'note'},
          'This browser draws nothing in 3D: it has no WebGL. Time and figures move all the same.'));
        return;
      }
      this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
      this.camera = new THREE.PerspectiveCamera(35, 1, 0.05, 50);
      this.camera.up.set(0, 0, 1);
      this.controls = new THREE.OrbitControls(this.camera, this.canvas);
      this.controls.addEventListener('change', () => this.draw());
      this.controls.addEventListener('start', () => { this.turned = true; });
      // A wheel or a finger scrolls the page across the picture, until the picture has the focus.
      this.canvas.style.touchAction = 'pan-y';
      this.controls.enableZoom = false;
      this.canvas.addEventListener('pointerdown', () => this.canvas.focus({preventScroll: true}));
      this.canvas.addEventListener('focus', () => { this.controls.enableZoom = true; });
      this.canvas.addEventListener('blur', () => { this.controls.enableZoom = false; });
      this.canvas.addEventListener('dblclick', () => this.fit());
      new ResizeObserver(() => this.resize()).observe(this.canvas);
      new IntersectionObserver((seen) => {
        this.inSight = seen.at(-1).isIntersecting;
        if (this.stale) this.draw();
      }).observe(this.canvas);
      document.addEventListener('visibilitychange', () => { if (this.stale) this.draw(); });
      window.addEventListener('beforeprint', () => this.render());  // paper has the whole page
    }

    // An empty scene, with light and a grid on the floor; the resources of the old scene are freed.
    clear(...roots) {
      if (this.scene) {
        this.scene.traverse((node) => [node.geometry, node.material].forEach((part) => part && part.dispose()));
      }
      const dark = matchMedia('(prefers-color-scheme: dark)').matches;
      this.scene = new THREE.Scene();
      this.scene.background = new THREE.Color(dark ? '#1D2327' : '#F4F6F8');
      const sun = new THREE.DirectionalLight('#FFFFFF', 1.8);
      sun.position.set(1, -2, 4);
      const grid = new THREE.GridHelper(3, 12, dark ? '#46525A' : '#C9CFD6', dark ? '#323B41' : '#DFE3E8').rotateX(Math.PI / 2);
      this.scene.add(new THREE.HemisphereLight('#FFFFFF', '#8A929C', 1.8), sun, grid, ...roots);
    }

    explain(entries) {
      this.legend.replaceChildren(...entries.map(([colour, text]) => {
        const swatch = element('span', {class: 'swatch', 'aria-hidden': 'true'});
        swatch.style.background = colour;
        return element('li', {}, swatch, text);
      }));
    }

    // Look at everything within bounds, across a direction of motion and away from the bases of the arms.
    frame(bounds, bodies, arms, along) {
      const centre = bounds.getCenter(new THREE.Vector3()), base = new THREE.Vector3();
      arms.forEach((arm) => base.add(bodies.links[`${arm}_base`].getWorldPosition(new THREE.Vector3())));
      base.divideScalar(arms.length || 1);
      along.setZ(0);
      if (along.length() < 1e-6) along.set(0, 1, 0);
      along.normalize();
      const aside = new THREE.Vector3(along.y, -along.x, 0);
      if (aside.dot(centre.clone().sub(base)) < 0) aside.negate();
      const direction = aside.addScaledVector(along, 0.35).add(new THREE.Vector3(0, 0, 0.45)).normalize();
      this.controls.target.copy(centre);
      this.camera.position.copy(centre).addScaledVector(direction, this.distance(bounds, centre, direction));
      this.controls.update();
      this.turned = false;
    }

    // Distance of the camera, in a direction, at which everything within the bounds is in the picture.
    distance(bounds, centre, direction) {
      const right = new THREE.Vector3(0, 0, 1).cross(direction).normalize(), up = direction.clone().cross(right);
      const upright = Math.tan(THREE.MathUtils.degToRad(this.camera.fov) / 2), across = upright * this.camera.aspect;
      const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => new THREE.Vector3(
        bits & 1 ? bounds.max.x : bounds.min.x, bits & 2 ? bounds.max.y : bounds.min.y,
        bits & 4 ? bounds.max.z : bounds.min.z).sub(centre));
      return MARGIN * Math.max(...corners.map((corner) => corner.dot(direction)
        + Math.max(Math.abs(corner.dot(up)) / upright, Math.abs(corner.dot(right)) / across)));
    }

    resize() {
      const {clientWidth: width, clientHeight: height} = this.canvas;
      if (!width || !height) return;
      const first = !this.sized;
      this.sized = true;
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      if (first) this.fit(); else this.draw();
    }

    // A picture out of sight is drawn once it comes into sight: without a graphics card a picture takes a core.
    draw() {
      this.stale = !this.inSight || document.hidden;
      if (!this.stale) this.render();
    }

    render() {
      if (this.renderer && this.scene) this.renderer.render(this.scene, this.camera);
    }
  }

  // Samples of one side, as numbers.
  function unpacked(side) {
    return side && {
      joints: floats(side.joints),
      forces: side.forces && floats(side.forces),
      objects: [side.object, ...(side.neighbours || [])].map((poses) => poses && floats(poses)),
      jumps: side.jumps,
    };
  }

  class Replay extends Stage {
    constructor(parent, data, options = {}) {
      super(parent);
      this.data = data;
      this.onSeek = options.onSeek || (() => {});
      this.build();
      this.show(options.run || 0);
    }

    build() {
      this.button = element('button', {type: 'button'}, 'Play');
      this.toImpact = element('button', {type: 'button', title: 'to the impact (I)'}, 'Impact');
      this.slider = element('input', {type: 'range', min: '0', max: '1', step: 'any', 'aria-label': 'time'});
      this.speed = select('speed', [['slow', `slow at the impact, 1 : ${SLOW_MOTION}`], ['1', '1 : 1'],
                                    ['10', '1 : 10'], ['100', '1 : 100']]);
      this.larger = select('scale of the difference between model and measurement',
                           [['1', 'model true to size'], ['10', 'differences × 10'], ['100', 'differences × 100']]);
      const controls = element('div', {class: 'replay-controls'}, this.button, this.toImpact, this.slider);
      const choices = element('div', {}, this.speed, this.larger);
      this.parent.append(this.canvas, controls, choices, this.readout, this.legend);
      this.parent.setAttribute('role', 'group');
      this.parent.setAttribute('aria-label', '3D replay: space plays, arrow keys step by 1 ms, with shift by 10 ms');
      this.button.addEventListener('click', () => (this.playing ? this.pause() : this.play()));
      this.toImpact.addEventListener('click', () => { this.pause(); this.seek(this.run.impact); });
      this.slider.addEventListener('input', () => {
        this.pause();
        this.seek(this.timeAt(this.slider.value * this.length));
      });
      this.speed.addEventListener('change', () => { this.cut(); this.seek(this.time); });
      this.larger.addEventListener('change', () => this.seek(this.time));
      this.parent.addEventListener('keydown', (event) => this.key(event));
      this.open();
    }

    // Show a run, at its impact.
    show(number) {
      this.pause();
      this.number = number;
      const packed = this.data.runs[number], scene = this.data.scenes[packed.scene];
      this.run = {...packed, time: floats(packed.time), measured: unpacked(packed.measured),
                  model: unpacked(packed.model)};
      this.arms = scene.arms;
      this.columns = scene.joints.filter((joint) => joint.column !== undefined).length;
      this.measured = new Bodies(scene, false);
      this.model = this.run.model && new Bodies(scene, true);
      this.larger.hidden = !this.model;
      this.toImpact.hidden = this.run.impact === null;
      this.speed.options[0].hidden = this.run.impact === null;
      if (this.run.impact === null && this.speed.value === 'slow') this.speed.value = '1';
      this.canvas.setAttribute('aria-label', `${packed.label}: ${this.arms.join(' and ')} in 3D`);
      this.furnish();
      this.cut();
      this.fit();
      this.seek(this.run.impact === null ? this.run.time[0] : this.run.impact);
    }

    // Bodies and arrows in the scene of a run.
    furnish() {
      this.clear(this.measured.root);
      if (this.model) this.scene.add(this.model.root);
      const sides = [this.run.measured, this.run.model].filter(Boolean);
      const lengths = (values) => Math.max(1e-9, ...values.map((value) => Math.hypot(...value)));
      const forces = sides.flatMap((side) => side.forces ? this.triples(side.forces) : []);
      const speeds = sides.flatMap((side) => side.jumps.flatMap((jump) => [jump.before, jump.after]));
      this.newton = LONGEST_ARROW / lengths(forces);
      this.metrePerSecond = LONGEST_ARROW / lengths(speeds);
      this.forces = [];
      this.velocities = new THREE.Group();
      [this.run.measured, this.run.model].forEach((side, number) => {
        if (!side) return;
        this.forces.push(this.arms.map(() => new Arrow(number ? GHOST : FORCE, number ? 0.004 : 0.007)));
        side.jumps.forEach((jump) => {
          const top = new THREE.Vector3(...jump.place);
          if (jump.arm === null) top.z += this.data.scenes[this.run.scene].object[2] / 2;
          ['before', 'after'].forEach((when) => {
            if (number && when === 'before') return;  // it starts as measured
            const arrow = new Arrow(number ? GHOST : {before: BEFORE, after: AFTER}[when], 0.005);
            const start = top.clone().setZ(top.z + ABOVE[number ? 'model' : when]);
            arrow.set(start, new THREE.Vector3(...jump[when]).multiplyScalar(this.metrePerSecond));
            this.velocities.add(arrow.root);
          });
        });
      });
      this.forces.flat().forEach((arrow) => this.scene.add(arrow.root));
      this.scene.add(this.velocities);
      this.explain(this.entries(forces.length > 0, speeds.length > 0));
    }

    triples(values) {
      return Array.from({length: values.length / 3}, (_, row) => values.subarray(3 * row, 3 * row + 3));
    }

    entries(forces, velocities) {
      const entries = [['#8A929C', 'measured']];
      const long = (scale, unit) => ` (${(100 * LONGEST_ARROW).toFixed(0)} cm: ${(LONGEST_ARROW / scale).toPrecision(3)} ${unit})`;
      if (this.model) entries.push([GHOST, 'model']);
      if (forces) entries.push([FORCE, `force on the object${long(this.newton, 'N')}`]);
      if (velocities) {
        entries.push([BEFORE, `velocity before the impact${long(this.metrePerSecond, 'm/s')}`]);
        entries.push([AFTER, 'velocity after it']);
      }
      return entries;
    }

    // Playing time over time of the run: stretches follow each other, and the impact is stretched.
    cut() {
      const {time, starts, slow} = this.run, stretched = this.speed.value === 'slow';
      this.knots = [];
      let played = 0;
      starts.forEach((start, number) => {
        const first = time[start], last = time[(starts[number + 1] || time.length) - 1];
        const inside = slow ? slow.filter((moment) => moment > first && moment < last) : [];
        [first, ...inside, last].forEach((moment, index, moments) => {
          if (index > 0) {
            const middle = (moments[index - 1] + moment) / 2;
            const isSlow = stretched && slow && middle > slow[0] && middle < slow[1];
            played += (moment - moments[index - 1]) * (isSlow ? SLOW_MOTION : stretched ? 1 : Number(this.speed.value));
          }
          this.knots.push([moment, played]);
        });
      });
      this.length = played;
    }

    between(value, from, to) {
      const knots = this.knots;
      let row = knots.findIndex((knot) => knot[from] > value);
      if (row === 0) return knots[0][to];
      if (row < 0) return knots[knots.length - 1][to];
      const [before, after] = [knots[row - 1], knots[row]];
      return before[to] + (value - before[from]) / (after[from] - before[from]) * (after[to] - before[to]);
    }

    playedAt(time) { return this.between(time, 0, 1); }

    timeAt(played) { return this.between(played, 1, 0); }

    // The sample at or before a time, and the share of the way to the next one; a gap is not crossed.
    row(time) {
      const times = this.run.time;
      let low = 0, high = times.length - 1;
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (times[middle] <= time) low = middle; else high = middle - 1;
      }
      if (low === times.length - 1 || this.run.starts.includes(low + 1)) return [low, 0];
      return [low, Math.max(0, (time - times[low]) / (times[low + 1] - times[low]))];
    }

    values(samples, width, [row, share]) {
      const next = share > 0 ? row + 1 : row;
      return Array.from({length: width}, (_, i) =>
        (1 - share) * samples[row * width + i] + share * samples[next * width + i]);
    }

    // Move everything to a time of the run [s].
    seek(time) {
      const {time: times, measured, model} = this.run;
      this.time = Math.min(Math.max(time, times[0]), times[times.length - 1]);
      const at = this.row(this.time);
      const sides = [[this.measured, measured], [this.model, model]].filter(([bodies]) => bodies);
      const forces = sides.map(([bodies, side], number) => {
        let joints = this.values(side.joints, this.columns, at);
        let poses = side.objects.map((samples) => samples && this.values(samples, 7, at));
        if (number) {
          const larger = Number(this.larger.value);
          const scaled = (truth, values) => values.map((value, i) => truth[i] + larger * (value - truth[i]));
          joints = scaled(this.values(measured.joints, this.columns, at), joints);
          poses = poses.map((pose, i) =>
            (pose && measured.objects[i] ? scaled(this.values(measured.objects[i], 7, at), pose) : pose));
        }
        bodies.place(joints, poses);
        const hands = bodies.positions();
        return this.arms.map((arm, index) => {
          const force = side.forces && this.values(side.forces, 3 * this.arms.length, at).slice(3 * index, 3 * index + 3);
          this.forces[number][index].set(new THREE.Vector3(...hands[`${arm}_end_effector`]),
                                         new THREE.Vector3(...(force || [0, 0, 0])).multiplyScalar(this.newton));
          return force && Math.hypot(...force);
        });
      });
      const slow = this.run.slow;
      this.velocities.visible = slow !== null && this.time >= slow[0] && this.time <= slow[1];
      this.showForces(forces);
      this.slider.value = this.length > 0 ? this.playedAt(this.time) / this.length : 0;
      this.draw();
      this.onSeek(this.time, this.number);
    }

    showForces(forces) {
      const impact = this.run.impact, words = [`${this.time.toFixed(3)} s`];
      if (impact !== null) {
        const since = 1000 * (this.time - impact);
        words.push(Math.abs(since) < 0.5 ? 'the impact'
          : `${Math.abs(since).toFixed(0)} ms ${since < 0 ? 'before' : 'after'} the impact`);
      }
      const newtons = (value) => `${value.toFixed(0)} N`;
      this.arms.forEach((arm, index) => {
        if (forces[0][index] === null) return;
        const name = this.arms.length > 1 ? `force of ${arm}` : 'force';
        words.push(`${name} ${newtons(forces[0][index])}${forces[1] ? ` (model ${newtons(forces[1][index])})` : ''}`);
      });
      this.readout.textContent = words.join(' · ');
      this.slider.setAttribute('aria-valuetext', words.slice(0, 2).join(', '));
    }

    play() {
      if (this.playing) return;
      if (this.time >= this.run.time[this.run.time.length - 1]) this.seek(this.run.time[0]);
      this.button.textContent = 'Pause';
      let before = null, played = this.playedAt(this.time);
      const step = (now) => {
        played += before === null ? 0 : (now - before) / 1000;
        before = now;
        this.seek(this.timeAt(Math.min(played, this.length)));
        if (played >= this.length) this.pause();
        else this.playing = requestAnimationFrame(step);
      };
      this.playing = requestAnimationFrame(step);
    }

    pause() {
      cancelAnimationFrame(this.playing);
      this.playing = null;
      this.button.textContent = 'Play';
    }

    key(event) {
      if (event.target.tagName === 'SELECT' || event.ctrlKey || event.altKey || event.metaKey) return;
      const step = event.shiftKey ? BIG_STEP : STEP, times = this.run.time;
      const moves = {ArrowLeft: this.time - step, ArrowRight: this.time + step, Home: times[0],
                     End: times[times.length - 1], i: this.run.impact};
      if (event.key === ' ' && event.target.tagName !== 'BUTTON') {
        if (this.playing) this.pause(); else this.play();
      } else if (event.key in moves && moves[event.key] !== null) {
        this.pause();
        this.seek(moves[event.key]);
      } else return;
      event.preventDefault();
    }

    // Look at all that moves, from the side of its motion.
    fit() {
      if (!this.renderer) return;
      const bounds = new THREE.Box3();
      const {time, measured} = this.run;
      for (let row = 0; row < time.length; row += Math.ceil(time.length / 24)) {
        const poses = measured.objects.map((samples) => samples && this.values(samples, 7, [row, 0]));
        this.measured.place(this.values(measured.joints, this.columns, [row, 0]), poses);
        this.measured.root.updateMatrixWorld(true);
        Object.entries(this.measured.links).forEach(([name, link]) => {
          if (name === 'support' || name === 'world') return;
          link.children.filter((child) => child.isMesh).forEach((child) => bounds.expandByObject(child, true));
        });
        this.measured.expand(bounds, true);
      }
      const along = new THREE.Vector3(...(measured.jumps.length ? measured.jumps[0].before : [0, 1, 0]));
      this.frame(bounds, this.measured, this.arms, along);
      if (this.time !== undefined) this.seek(this.time);
    }
  }

  // A graph as it runs.
  class Live extends Stage {
    constructor(parent) {
      super(parent);
      this.show(null);
      parent.append(this.canvas, this.readout, this.legend);
      this.open();
    }

    // The scene; null: not known.
    show(scene) {
      this.arms = scene ? scene.arms : [];
      this.measured = scene && new Bodies(scene, false);
      this.forces = this.arms.map(() => new Arrow(FORCE, 0.007));
      this.state = null;
      this.most = FULL[0];
      this.moved = new THREE.Box3();  // everything that has moved so far
      this.shown = null;  // bounds that the camera shows
      this.clear(...(scene ? [this.measured.root] : []), ...this.forces.map((arrow) => arrow.root));
      if (scene) this.measured.root.visible = false;  // until joint positions arrive
      this.forces.forEach((arrow) => arrow.set(new THREE.Vector3(), new THREE.Vector3()));
      const what = this.arms.join(' and ') || 'a robot';
      this.canvas.setAttribute('aria-label', scene ? `${what} in 3D, live` : 'an empty scene');
      this.explain([]);
      this.readout.textContent = '';
      if (scene) this.draw();
      else this.fit();
    }

    // The newest state: joints of all arms side by side [rad], poses of the object and its neighbours or null, forces by
    // arm [N] or null.
    update(state) {
      this.state = state;
      this.measured.root.visible = true;
      this.measured.place(state.joints, [state.object, ...(state.neighbours || [])]);
      const hands = this.measured.positions(), hasForces = state.forces !== null;
      const newtons = hasForces ? state.forces.map((force) => Math.hypot(...force)) : [];
      this.most = FULL.find((most) => most >= Math.max(this.most, ...newtons)) || FULL[FULL.length - 1];
      this.forces.forEach((arrow, index) => {
        const force = new THREE.Vector3(...(hasForces ? state.forces[index] : [0, 0, 0]));
        arrow.set(new THREE.Vector3(...hands[`${this.arms[index]}_end_effector`]),
                  force.multiplyScalar(LONGEST_ARROW / this.most));
      });
      const words = state.time === null ? [] : [`${state.time.toFixed(3)} s`];
      newtons.forEach((value, index) =>
        words.push(`force${this.arms.length > 1 ? ` of ${this.arms[index]}` : ''} ${value.toFixed(0)} N`));
      this.readout.textContent = words.join(' · ');
      const long = ` (${(100 * LONGEST_ARROW).toFixed(0)} cm: ${this.most} N)`;
      this.explain([['#8A929C', 'newest state'], ...(hasForces ? [[FORCE, `force on the object${long}`]] : [])]);
      this.look(hands);
      this.draw();
    }

    // Keep all that has moved in the picture, until a reader turns it.
    look(hands) {
      Object.entries(hands).forEach(([name, position]) => {
        if (name !== 'support' && name !== 'world') this.moved.expandByPoint(new THREE.Vector3(...position));
      });
      this.measured.expand(this.moved);
      if (this.shown && (this.turned || this.shown.containsBox(this.moved))) return;
      this.fit();
    }

    fit() {
      if (!this.renderer) return;
      const empty = new THREE.Box3(...EMPTY.map((corner) => new THREE.Vector3(...corner)));
      if (this.state) this.shown = this.moved.clone().expandByScalar(ROOM);
      this.frame(this.shown || empty, this.measured, this.state ? this.arms : [], new THREE.Vector3(0, 1, 0));
      this.draw();
    }
  }

  // The interval of an arrow's tip: a bar between its ends.
  class Interval {
    constructor(colour) {
      const material = new THREE.MeshBasicMaterial({color: colour, depthTest: false, transparent: true, opacity: 0.45});
      this.root = new THREE.Mesh(new THREE.CylinderGeometry(0.016, 0.016, 1, 16), material);
      this.root.renderOrder = 1;
    }

    set(low, high) {
      const along = high.clone().sub(low), length = along.length();
      this.root.visible = length > 1e-4;
      if (!this.root.visible) return;
      this.root.position.copy(low).addScaledVector(along, 0.5);
      this.root.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.divideScalar(length));
      this.root.scale.y = Math.max(length, 0.004);
    }
  }

  // One moment: bodies where they are, velocities before and after the impact with their intervals.
  class Picture extends Stage {
    constructor(parent) {
      super(parent);
      parent.append(this.canvas, this.legend);
      this.clear();
      this.open();
    }

    show(scene) {
      this.arms = scene.arms;
      this.size = scene.object;
      this.measured = new Bodies(scene, false);
      this.arrows = [];
      this.moment = this.most = null;
      this.clear(this.measured.root);
      this.canvas.setAttribute('aria-label', `${this.arms.join(' and ')} at the impact in 3D, with velocities`);
    }

    // Joints of all arms side by side [rad], poses of the object and its neighbours, and by body: arm (null: the object),
    // velocities before and after and the ends of the interval [m/s], null where there is none.
    update(moment) {
      const first = this.moment === null;
      this.moment = moment;
      this.measured.place(moment.joints, [moment.object, ...(moment.neighbours || [])]);
      const hands = this.measured.positions(), vector = (values) => new THREE.Vector3(...values);
      const fastest = Math.max(1e-9, ...moment.jumps.flatMap((jump) => [jump.before, jump.after]).map((velocity) => Math.hypot(...velocity)));
      // The scale stays while a slider moves, so that arrows grow with velocities.
      if (this.most === null || fastest > 2 * this.most) this.most = [0.1, 0.2, 0.5, 1, 2, 5, 10].find((speed) => speed >= fastest) || fastest;
      const scale = LONGEST_ARROW / this.most;
      while (this.arrows.length < moment.jumps.length) {
        const arrows = {before: new Arrow(BEFORE, 0.006), after: new Arrow(AFTER, 0.006), interval: new Interval(AFTER)};
        this.arrows.push(arrows);
        this.scene.add(arrows.before.root, arrows.interval.root, arrows.after.root);
      }
      moment.jumps.forEach((jump, index) => {
        const arrows = this.arrows[index];
        const start = jump.arm === null ? vector(moment.object) : vector(hands[`${jump.arm}_end_effector`]);
        if (jump.arm === null && this.size) start.z += this.size[2] / 2;
        const at = (when) => start.clone().setZ(start.z + ABOVE[when]);
        arrows.before.set(at('before'), vector(jump.before).multiplyScalar(scale));
        arrows.after.set(at('after'), vector(jump.after).multiplyScalar(scale));
        if (jump.low) {
          const [low, high] = [jump.low, jump.high].map((end) => at('after').addScaledVector(vector(end), scale));
          arrows.interval.set(low, high);
        } else arrows.interval.root.visible = false;
      });
      if (this.explained !== this.most) this.explain([[BEFORE, `before the impact (${(100 * LONGEST_ARROW).toFixed(0)} cm: ${this.most} m/s)`],
        [AFTER, 'after it, with its 95 % interval']]);
      this.explained = this.most;
      if (first) this.fit(); else this.draw();
    }

    fit() {
      if (!this.renderer || !this.moment) return;
      const bounds = new THREE.Box3();
      Object.entries(this.measured.links).forEach(([name, link]) => {
        if (name === 'support' || name === 'world') return;
        link.children.filter((child) => child.isMesh).forEach((child) => bounds.expandByObject(child, true));
      });
      this.measured.expand(bounds, true);
      const moving = this.moment.jumps.find((jump) => Math.hypot(...jump.before) > 0);
      this.frame(bounds, this.measured, this.arms, new THREE.Vector3(...(moving ? moving.before : [0, 1, 0])));
      this.draw();
    }
  }

  return {ImpactReplay: Replay, ImpactLive: Live, ImpactPicture: Picture};
})();
