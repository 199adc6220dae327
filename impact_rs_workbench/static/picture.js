// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Scenes in 3D: the impact of a scenario with an answer of the impact map, and recorded trials. replay.js draws them.
// It and its library are loaded when they are first needed, after the first numbers.

import {ask, h, LatestRequest, load, query} from './tools.js';

const LIBRARIES = ['/static/three.js', '/static/replay.js'];
let loading = null;

/** The libraries, once. @returns {Promise<void>} */
export function threeD() {
  loading ??= LIBRARIES.reduce((before, address) => before.then(() => load(address)), Promise.resolve());
  return loading;
}

/** A recorded run in a node of the page; returns the replay. @param {Element} node */
export async function replayIn(node, data, options = {}) {
  await threeD();
  const place = h('div', {class: 'replay'});
  node.replaceChildren(place);
  return new ImpactReplay(place, data, options);
}

/** The impact of a scenario; the newest answer is drawn once per frame. */
export class ImpactScene {
  /** @param {HTMLElement} node */
  constructor(node) {
    this.node = node;
    this.key = null; // scenario and object of the scene that is drawn or awaited
    this.newest = null; // answer of the impact map
    this.drawing = false;
    this.ready = false;
    this.requests = new LatestRequest();
  }

  /** Asks for a scene before its answer is there. @param {string} scenario @param {string} object */
  ahead(scenario, object) {
    const scene = ask(`/api/scene?${query({name: scenario, object})}`);
    this.coming = {key: JSON.stringify([scenario, object]), scene};
    scene.catch(() => {}); // shown where it is drawn
  }

  /** @param {string} scenario @param {string} object @param {any} moment of the answer */
  async draw(scenario, object, moment) {
    const key = JSON.stringify([scenario, object]);
    this.newest = moment;
    if (this.key === key) { this.soon(); return; }
    const turn = this.requests.begin();
    this.key = key;
    this.ready = false;
    if (this.coming?.key !== key) this.ahead(scenario, object);
    const [scene] = await turn.of(Promise.all([this.coming.scene, threeD()])).catch((error) => {
      this.key = this.coming = null; // asked for again by the next answer
      throw error;
    });
    if (!this.picture) {
      const place = h('div', {class: 'replay'});
      this.node.replaceChildren(place);
      this.picture = new ImpactPicture(place);
    }
    this.picture.show(scene);
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
