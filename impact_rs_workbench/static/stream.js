// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Running nodes in 3D: receives scene, status and state, and draws the newest state once per frame. Needs replay.js and
// its library.

/**
 * @param {string} address of the events
 * @param {HTMLElement} node place of the picture
 * @param {object} hear
 * @param {(text: string) => void} hear.status is given each status line
 * @param {(lost: boolean) => void} hear.lost whether the server is gone
 * @param {(messages: any) => void} hear.followed is given the messages of a node identify
 * @param {(scene: any) => void} [hear.scene] is given each new scene
 * @param {(state: any) => void} [hear.state] is given each state
 */
export function watch(address, node, {status, lost, followed, scene = () => {}, state = () => {}}) {
  const live = new ImpactLive(node), events = new EventSource(address);
  let newest = null, drawing = false;

  function draw() {
    drawing = false;
    if (newest && live.measured) live.update(newest);
  }

  events.addEventListener('scene', ({data}) => {
    newest = null;
    const received = JSON.parse(data);
    live.show(received);
    scene(received);
  });
  events.addEventListener('status', ({data}) => {
    const text = JSON.parse(data);
    status(`${text[0].toUpperCase()}${text.slice(1)}.`);
  });
  events.addEventListener('state', ({data}) => {
    newest = JSON.parse(data);
    if (newest) state(newest);
    if (!drawing) requestAnimationFrame(draw);
    drawing = true;
  });
  events.addEventListener('followed', ({data}) => followed(JSON.parse(data)));
  events.addEventListener('open', () => lost(false));
  events.addEventListener('error', () => lost(true));
  return {live, events};
}
