// SPDX-License-Identifier: Apache-2.0
// The page of running nodes: receives scene and state, and draws the newest state once per frame.
'use strict';
(function () {
  const live = new ImpactLive(document.getElementById('live'));
  const status = document.getElementById('status'), lost = document.getElementById('lost');
  const events = new EventSource('/api/events');
  let newest = null, drawing = false;

  function draw() {
    drawing = false;
    if (newest && live.measured) live.update(newest);
  }

  events.addEventListener('scene', (event) => {
    newest = null;
    live.show(JSON.parse(event.data));
  });
  events.addEventListener('status', (event) => {
    const text = JSON.parse(event.data);
    status.textContent = `${text[0].toUpperCase()}${text.slice(1)}.`;
  });
  events.addEventListener('state', (event) => {
    newest = JSON.parse(event.data);
    if (!drawing) requestAnimationFrame(draw);
    drawing = true;
  });
  events.addEventListener('open', () => { lost.hidden = true; });
  events.addEventListener('error', () => { lost.hidden = false; });
  window.impact_rs = {live, events};  // for the browser's console
})();
