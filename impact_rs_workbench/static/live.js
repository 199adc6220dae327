// SPDX-License-Identifier: Apache-2.0
// The page of a running graph: hears what stands there and where it is, and draws the newest once per picture.
'use strict';
(function () {
  const live = new ImpactLive(document.getElementById('live'));
  const status = document.getElementById('status'), lost = document.getElementById('lost');
  const told = new EventSource('/api/events');
  let newest = null, drawing = false;

  function draw() {
    drawing = false;
    if (newest && live.measured) live.update(newest);
  }

  told.addEventListener('scene', (event) => {
    newest = null;
    live.show(JSON.parse(event.data));
  });
  told.addEventListener('status', (event) => {
    const text = JSON.parse(event.data);
    status.textContent = `${text[0].toUpperCase()}${text.slice(1)}.`;
  });
  told.addEventListener('state', (event) => {
    newest = JSON.parse(event.data);
    if (!drawing) requestAnimationFrame(draw);
    drawing = true;
  });
  told.addEventListener('open', () => { lost.hidden = true; });
  told.addEventListener('error', () => { lost.hidden = false; });
  window.impact_rs = {live, told};  // to be looked at from the browser's console
})();
