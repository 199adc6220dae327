// SPDX-License-Identifier: Apache-2.0
// @ts-check
// The page of the workbench: its steps, and the events of the server. It stores nothing itself: all results are files.

import {showFolder} from './folder.js';
import {showJobs} from './jobs.js';
import {addStep, followAddress, refresh} from './navigation.js';
import {add} from './steps/add.js';
import {compare} from './steps/compare.js';
import {diagnose} from './steps/diagnose.js';
import {history} from './steps/history.js';
import {investigate} from './steps/investigate.js';
import {laboratory} from './steps/laboratory.js';
import {live} from './steps/live.js';
import {measure} from './steps/measure.js';
import {overlay} from './steps/overlay.js';
import {impact, predict} from './steps/predict.js';
import {recorded} from './steps/trials.js';
import {$, state} from './tools.js';

function listen() {
  const events = new EventSource('/api/events');
  events.addEventListener('jobs', ({data}) => showJobs(JSON.parse(data)));
  events.addEventListener('workspace', ({data}) => {
    const first = !state.workspace;
    state.workspace = JSON.parse(data);
    showFolder();
    if (first) showJobs(state.jobs); // those that came before show their paths relative to the folder
    refresh();
  });
  events.addEventListener('open', () => { $('lost').hidden = true; });
  events.addEventListener('error', () => { $('lost').hidden = false; });
}

addStep('predict', 'Predict', predict);
addStep('measure', 'Measure', measure);
addStep('laboratory', 'Laboratory', laboratory);
addStep('compare', 'Compare', compare);
addStep('diagnose', 'Diagnose', diagnose);
addStep('add', 'Add', add);
addStep('history', 'History', history);
addStep('overlay', 'Overlay', overlay);
addStep('investigate', 'Investigate', investigate);
followAddress();
listen();
window.impact_rs = {predict: impact, recorded, nodes: live}; // for the browser's console
