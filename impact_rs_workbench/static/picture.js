// SPDX-License-Identifier: Apache-2.0
/* global ImpactReplay, ImpactPicture */
// Scenes in 3D: the impact of a scenario with an answer of the impact map, and recorded trials. replay.js draws; it and its
// library come when they are first needed, behind the first numbers.

import {load, Questions} from './tools.js';

const LIBRARIES = ['/static/three.js', '/static/replay.js'];
let loading = null;

// The libraries, once.
export function threeD() {
  loading ??= LIBRARIES.reduce((before, address) => before.then(() => load(address)), Promise.resolve());
  return loading;
}

const place = () => Object.assign(document.createElement('div'), {className: 'replay'});

// A recorded run in a node of the page; returns the replay.
export async function replayIn(node, data, options) {
  await threeD();
  const made = place();
  node.replaceChildren(made);
  return new ImpactReplay(made, data, options);
}

// The impact of a scenario. `scene` gets the scene of a scenario and an object; the newest answer is drawn once per frame.
export class Impact {
  constructor(node, scene) {
    Object.assign(this, {node, scene, key: null, newest: null, drawing: false, questions: new Questions()});
  }

  // Ask for a scene before its answer is there.
  ahead(scenario, object) {
    this.coming = {key: JSON.stringify([scenario, object]), scene: this.scene(scenario, object)};
    this.coming.scene.catch(() => {}); // said where it is drawn
  }

  async draw(scenario, object, moment) {
    const key = JSON.stringify([scenario, object]);
    this.newest = moment;
    if (this.key === key) { this.soon(); return; }
    const turn = this.questions.begin();
    this.key = key;
    this.ready = false;
    if (this.coming?.key !== key) this.ahead(scenario, object);
    const [found] = await turn.of(Promise.all([this.coming.scene, threeD()])).catch((error) => {
      this.key = this.coming = null; // asked for again by the next answer
      throw error;
    });
    if (!this.picture) {
      this.node.replaceChildren(place());
      this.picture = new ImpactPicture(this.node.firstChild);
    }
    this.picture.show(found);
    this.ready = true;
    this.soon();
  }

  soon() {
    if (!this.ready || this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => {
      this.drawing = false;
      if (this.ready) this.picture.update(this.newest);
      this.node.dataset.shown = this.key;
    });
  }
}
