// SPDX-License-Identifier: Apache-2.0
// @ts-check
// The page of impact-rs show --live.

import {showFollowed} from './followed.js';
import {watch} from './stream.js';
import {$} from './tools.js';

window.impact_rs = watch('/api/events', $('live'), { // for the browser's console
  status(text) { $('status').textContent = text; },
  followed(messages) { showFollowed($('followed'), messages); },
  lost(is) { $('lost').hidden = !is; },
});
