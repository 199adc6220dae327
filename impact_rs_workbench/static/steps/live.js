// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Running nodes, a tab of Measure: in 3D, as `impact-rs show --live` shows them, and their newest signals over time.

import {colourOf, draw, legendHeight, LEGEND_BELOW, plotPlace} from '../figures.js';
import {showFollowed} from '../followed.js';
import {onJobs} from '../jobs.js';
import {go, inSight} from '../navigation.js';
import {threeD} from '../picture.js';
import {watch} from '../stream.js';
import {h, inFolder, labelled, LatestRequest, query, state} from '../tools.js';
import {recorded} from './trials.js';

/** @typedef {import('../types.d.ts').Step} Step */

const WINDOW = 6; // s of signals that are kept
const PAINTED = 200; // ms, between two pictures of the signals

/** @typedef {import('../types.d.ts').Job} Job */

// ---- jobs whose trials can be watched -----------------------------------------------------------------------------

const TRIALS = ['campaign', 'trial', 'blind', 'investigate']; // commands

/** The value of an option of a job; undefined: it was not given. @param {Job} job @param {string} flag */
function optionOf(job, flag) {
  const index = job.arguments.indexOf(flag);
  return index < 0 ? undefined : job.arguments[index + 1];
}

const byNodes = (job) => optionOf(job, '--via') === 'nodes';

/** Whether a job runs trials that can be watched, and in which tab of Measure. @param {Job} job */
export function watchable(job) {
  if (job.ended !== null || !TRIALS.includes(job.arguments[0])) return null;
  return byNodes(job) ? 'live' : 'recorded';
}

/** Shows the trials of a job. @param {Job} job */
export function watchJob(job) {
  const folder = inFolder(job.writes[0] ?? '');
  go('measure', watchable(job) ?? 'recorded');
  recorded.wanted = state.workspace.campaigns.find((campaign) => `${campaign.path}/`.startsWith(`${folder}/`))?.path;
  recorded.update();
}

// ---- signals ------------------------------------------------------------------------------------------------------

/** Samples of the newest states, by signal. A trial that begins has an earlier time, and begins them anew. */
class Samples {
  constructor() { this.clear(); }

  clear() {
    /** @type {number[]} */
    this.time = [];
    /** @type {Record<string, number[][]>} */
    this.values = {};
  }

  add({time, velocities, forces}) {
    const now = time ?? performance.now() / 1000;
    if (this.time.at(-1) > now) this.clear();
    if (this.time.at(-1) === now) return;
    this.time.push(now);
    const put = (name, values) => {
      const rows = this.values[name] ??= [];
      for (const [index, value] of values.entries()) (rows[index] ??= []).push(value);
    };
    if (velocities) put('velocity', velocities);
    if (forces) put('force', forces.map((force) => Math.hypot(...force)));
    const drop = this.time.findIndex((sampled) => sampled >= now - WINDOW);
    if (drop > 0) for (const row of [this.time, ...Object.values(this.values).flat()]) row.splice(0, drop);
  }

  // Time of the newest samples of a row, which may have begun later than others.
  of(row) { return this.time.slice(this.time.length - row.length); }
}

const moving = (scene) => scene.joints.filter(({column}) => column !== undefined).sort((a, b) => a.column - b.column);

function speedUnit(types) {
  if (!types.includes('prismatic')) return 'rad/s';
  return types.every((type) => type === 'prismatic') ? 'm/s' : 'rad/s, m/s';
}

const SIGNALS = {
  velocity: {title: 'Joint velocities', unit: (scene) => speedUnit(moving(scene).map((joint) => joint.type)),
    names: (scene) => moving(scene).map((joint) => joint.child)},
  force: {title: 'Force on the object', unit: () => 'N', names: (scene) => scene.arms},
};

// ---- the tab ------------------------------------------------------------------------------------------------------

/** @implements {Step} */
class LivePart {
  build() {
    this.requests = new LatestRequest();
    this.samples = new Samples();
    this.watching = this.typed = this.painting = false;
    /** @type {number | null} of the job whose trials are shown when they are done */
    this.insideOf = null;
    const typed = () => { this.typed = true; this.restart(); };
    this.namespace = h('input', {id: 'live-namespace', placeholder: 'none', onchange: typed});
    this.status = h('p', {id: 'live-status', role: 'status'});
    this.inside = h('p', {class: 'note', id: 'live-inside'});
    this.place = h('div', {class: 'replay', id: 'live-scene'});
    this.followed = h('div', {id: 'live-followed'});
    this.parts = Object.entries(SIGNALS).map(([name, signal]) => {
      const plot = plotPlace(`${signal.title}, live`, {id: `live-${name}`});
      return {name, signal, plot, node: h('div', {hidden: true}, h('h3', {}, signal.title), plot)};
    });
    onJobs(() => this.jobs());
    return h('div', {}, h('div', {class: 'fields'}, labelled('ROS namespace', this.namespace)), this.inside,
      this.status, this.place, this.followed, ...this.parts.map(({node}) => node));
  }

  update() {}

  // Nodes are watched while their tab is in sight.
  sightChanged() { this.show(inSight('measure', 'live')); }

  restart() { this.show(false); this.show(true); }

  /** @param {boolean} is whether nodes are watched */
  async show(is) {
    if (!is) {
      this.requests.begin();
      this.watched?.events.close();
      this.watched = null;
      this.watching = false;
      return;
    }
    if (this.watching) return;
    this.watching = true;
    const turn = this.requests.begin(), address = `/api/live?${query({namespace: this.namespace.value.trim()})}`;
    this.status.className = '';
    this.status.textContent = 'Looking for nodes …';
    this.samples.clear();
    try {
      await turn.of(threeD());
      this.place.replaceChildren();
      const watched = this.watched = watch(address, this.place, {
        status: (text) => { this.status.textContent = text; },
        followed: (messages) => showFollowed(this.followed, messages),
        lost: (lost) => { if (lost && watched.events.readyState === EventSource.CLOSED) this.refused(address, turn); },
        scene: (scene) => { this.scene = scene; this.samples.clear(); },
        state: (newest) => { if (this.scene) { this.samples.add(newest); this.paint(); } },
      });
    } catch (error) { this.failed(error); }
  }

  // Why the server does not answer: a stream of events cannot carry the reason.
  async refused(address, turn) { try { await turn.ask(address); } catch (error) { this.failed(error); } }

  /** @param {Error} error */
  failed(error) {
    this.status.className = 'error';
    this.status.textContent = inFolder(error.message);
  }

  async paint() {
    if (this.painting || document.hidden) return;
    this.painting = true;
    try { await Promise.all(this.parts.map((part) => this.paintSignal(part))); } finally {
      setTimeout(() => { this.painting = false; }, PAINTED);
    }
  }

  async paintSignal({name, signal, plot, node}) {
    const rows = this.samples.values[name] ?? [];
    node.hidden = !rows.length;
    if (!rows.length) return;
    const data = signal.names(this.scene).map((text, row) => ({x: this.samples.of(rows[row]), y: rows[row], name: text,
      mode: 'lines', line: {width: 1.5, color: colourOf(row)}}));
    const below = 46 + legendHeight(plot, data.length);
    await draw(plot, {data, layout: {height: 180 + below, margin: {l: 60, r: 12, t: 8, b: below}, showlegend: true,
      uirevision: 1, hovermode: false, xaxis: {title: {text: 'time of the trial [s]', standoff: 4}},
      yaxis: {title: {text: `[${signal.unit(this.scene)}]`}, automargin: true},
      legend: {...LEGEND_BELOW, font: {size: 11}}}});
  }

  // A running job sets the namespace of its nodes; trials inside a command are shown when they are done.
  jobs() {
    const job = state.jobs.find((job) => job.ended === null && TRIALS.includes(job.arguments[0]));
    const nodes = job && byNodes(job), namespace = job && (optionOf(job, '--namespace') ?? '');
    if (nodes && !this.typed && this.namespace.value !== namespace) {
      this.namespace.value = namespace;
      if (this.watching) this.restart();
    }
    const inside = job && !nodes ? job.number : null;
    if (inside === this.insideOf) return;
    this.insideOf = inside;
    if (!inside) { this.inside.replaceChildren(); return; }
    const open = (event) => { event.preventDefault(); watchJob(job); };
    this.inside.replaceChildren(`The trials of job ${job.number} run inside its command, faster than real time. Each ` +
      'one is shown in 3D when it is done: ', h('a', {href: '#measure', onclick: open}, 'recorded trials'));
  }
}

export const live = new LivePart();
