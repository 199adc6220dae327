// SPDX-License-Identifier: Apache-2.0
// The page of impact-rs show --live.

import {showFollowed} from './followed.js';
import {watch} from './live.js';

const place = (id) => document.getElementById(id);

window.impact_rs = watch('/api/events', place('live'), { // for the browser's console
  status(text) { place('status').textContent = text; },
  followed(found) { showFollowed(place('followed'), found); },
  lost(is) { place('lost').hidden = !is; },
});
