// SPDX-License-Identifier: Apache-2.0
// Running nodes in a tab of Measure: in 3D, as `impact-rs show --live` shows them, and their newest signals over time.

import {draw} from './figures.js';
import {showFollowed} from './followed.js';
import {watch} from './live.js';
import {threeD} from './picture.js';
import {ask, h, inFolder, labelled, query, Questions, state} from './tools.js';

const WINDOW = 6; // s of signals that are kept
const PAINTED = 200; // ms, between two pictures of the signals
const COLOURS = ['#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#555555', '#7A5195'];
const speedUnit = (types) => types.includes('prismatic') ? types.every((one) => one === 'prismatic') ? 'm/s' : 'rad/s, m/s' : 'rad/s';

// Samples of the newest states, by signal. A trial that begins has an earlier time, and begins them anew.
class Samples {
  clear() { this.time = []; this.values = {}; }

  add({time, velocities, forces}, scene) {
    const now = time ?? performance.now() / 1000;
    if (this.time.at(-1) > now) this.clear();
    if (this.time.at(-1) === now) return;
    this.time.push(now);
    const put = (name, values) => { for (const [place, value] of values.entries()) ((this.values[name] ??= [])[place] ??= []).push(value); };
    if (velocities) put('velocity', velocities);
    if (forces) put('force', forces.map((force) => Math.hypot(...force)));
    const drop = this.time.findIndex((one) => one >= now - WINDOW);
    if (drop > 0) for (const row of [this.time, ...Object.values(this.values).flat()]) row.splice(0, drop);
    this.scene = scene;
  }

  // Time of the newest samples of a row, which may have begun later than others.
  of(row) { return this.time.slice(this.time.length - row.length); }
}

const SIGNALS = {
  velocity: {title: 'Joint velocities', unit: (scene) => speedUnit(moving(scene).map((one) => one.type)), names: (scene) => moving(scene).map((one) => one.child)},
  force: {title: 'Force on the object', unit: () => 'N', names: (scene) => scene.arms},
};
const moving = (scene) => scene.joints.filter((one) => one.column !== undefined).sort((a, b) => a.column - b.column);

export const live = {
  questions: new Questions(),
  samples: new Samples(),
  insideOf: null, // number of the job whose trials are seen when done

  build() {
    this.namespace = h('input', {id: 'live-namespace', placeholder: 'none', onchange: () => { this.typed = true; this.show(false); this.show(true); }});
    this.status = h('p', {id: 'live-status', role: 'status'});
    this.inside = h('p', {class: 'note', id: 'live-inside'});
    this.place = h('div', {class: 'replay', id: 'live-scene'});
    this.followed = h('div', {id: 'live-followed'});
    this.plots = Object.fromEntries(Object.entries(SIGNALS).map(([name, {title}]) => [name,
      h('div', {class: 'plot', id: `live-${name}`, role: 'img', 'aria-label': `${title}, live`})]));
    this.parts = Object.entries(SIGNALS).map(([name, {title}]) => h('div', {hidden: true}, h('h3', {}, title), this.plots[name]));
    return h('div', {}, h('div', {class: 'fields'}, labelled('ROS namespace', this.namespace)), this.inside, this.status, this.place, this.followed, ...this.parts);
  },

  // Whether the tab is in sight: nodes are watched only then.
  async show(is) {
    if (!is) {
      this.questions.begin();
      this.watched?.events.close();
      this.watched = this.watching = null;
      return;
    }
    if (this.watching) return;
    this.watching = true;
    const turn = this.questions.begin(), address = `/api/live?${query({namespace: this.namespace.value.trim()})}`;
    this.status.className = '';
    this.status.textContent = 'Looking for nodes …';
    this.samples.clear();
    try {
      await turn.of(threeD());
      this.place.replaceChildren();
      const watched = this.watched = watch(address, this.place, {
        status: (text) => { this.status.textContent = text; },
        followed: (found) => showFollowed(this.followed, found),
        lost: (is_) => { if (is_ && watched.events.readyState === EventSource.CLOSED) this.refused(address, turn); },
        scene: (scene) => { this.scene = scene; this.samples.clear(); },
        state: (newest) => { if (this.scene) { this.samples.add(newest, this.scene); this.paint(turn); } },
      });
    } catch (error) { this.failed(error); }
  },

  // Why the server does not answer: a stream of events cannot say it.
  async refused(address, turn) { try { await turn.ask(address); } catch (error) { this.failed(error); } },

  failed(error) {
    this.status.className = 'error';
    this.status.textContent = inFolder(error.message);
  },

  async paint(turn) {
    if (this.painting || document.hidden) return;
    this.painting = true;
    const {samples, scene} = this;
    try {
      await Promise.all(Object.entries(SIGNALS).map(([name, {unit, names}], place) => {
        const rows = samples.values[name] ?? [];
        this.parts[place].hidden = !rows.length;
        if (!rows.length) return null;
        const data = names(scene).map((text, row) => ({x: samples.of(rows[row]), y: rows[row], name: text, mode: 'lines', line: {width: 1.5, color: COLOURS[row % COLOURS.length]}}));
        const below = 46 + 19 * Math.ceil(data.length / Math.max(1, Math.floor(this.plots[name].clientWidth / 190)));
        return draw(this.plots[name], {data, layout: {height: 180 + below, margin: {l: 60, r: 12, t: 8, b: below}, showlegend: true, uirevision: 1, hovermode: false,
          xaxis: {title: {text: 'time of the trial [s]', standoff: 4}}, yaxis: {title: {text: `[${unit(scene)}]`}, automargin: true},
          legend: {orientation: 'h', yref: 'container', y: 0, yanchor: 'bottom', x: 0, font: {size: 11}}}});
      }));
    } finally { setTimeout(() => { this.painting = false; }, PAINTED); }
  },

  // Jobs that run: the namespace of their nodes; trials inside of a command are seen when they are done.
  jobs(recorded) {
    const job = state.jobs.find((one) => one.ended === null && TRIALS.includes(one.arguments[0]));
    const nodes = job && through(job);
    if (nodes && !this.typed && this.namespace.value !== namespaceOf(job)) {
      this.namespace.value = namespaceOf(job);
      if (this.watching) { this.show(false); this.show(true); }
    }
    const inside = job && !nodes ? job.number : null;
    if (inside === this.insideOf) return;
    this.insideOf = inside;
    this.inside.replaceChildren(...(inside ? [`The trials of job ${job.number} run inside its command, faster than real time; each is shown in 3D when it is done: `,
      h('a', {href: '#measure', onclick: (event) => { event.preventDefault(); recorded(job); }}, 'recorded trials')] : []));
  },
};

const TRIALS = ['campaign', 'trial', 'blind', 'investigate'];
const through = (job) => job.arguments[job.arguments.indexOf('--via') + 1] === 'nodes' && job.arguments.includes('--via');
const namespaceOf = (job) => job.arguments.includes('--namespace') ? job.arguments[job.arguments.indexOf('--namespace') + 1] : '';

// Whether a job runs trials that can be watched, and where: live, or as recorded trials.
export const watchable = (job) => job.ended === null && TRIALS.includes(job.arguments[0]) ? through(job) ? 'live' : 'recorded' : null;
