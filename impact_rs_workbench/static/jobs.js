// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Jobs: the drawer at the lower edge, their questions, replies beside the buttons that started them, and their output.

import {refresh} from './navigation.js';
import {$, ask, button, h, inFolder, LatestRequest, refill, seconds, state} from './tools.js';

/** @typedef {import('./types.d.ts').Job} Job */

const MOST_JOBS = 8; // in the drawer

// ---- what other modules want to know ------------------------------------------------------------------------------

/** @type {(() => void)[]} */
const listeners = [];
/** @type {Record<string, (written: string[]) => void>} */
const results = {};
/** @type {(job: Job) => string | null} */
let whereToWatch = () => null;
/** @type {(job: Job) => void} */
let watch = () => {};

/** Calls `act` after every change of jobs, once the folder is known. @param {() => void} act */
export function onJobs(act) { listeners.push(act); }

/**
 * Gives `act` the paths that a job of a command has written, when it is done.
 * @param {(written: string[]) => void} act
 */
export function whenDone(command, act) { results[command] = act; }

/**
 * What a click on "Watch" does, and for which jobs there is one.
 * @param {(job: Job) => string | null} where
 * @param {(job: Job) => void} act
 */
export function onWatch(where, act) {
  whereToWatch = where;
  watch = act;
}

// ---- texts of a job -----------------------------------------------------------------------------------------------

/** @param {Job} job */
export function progressText(job) {
  const {what = job.arguments[0], done = 0, total = null, left = null, share = null} = job.progress ?? {};
  return [job.stopping ? 'stopping' : job.question ? 'asks' : what, total ? `${done} of ${total}` : '',
    share === null ? '' : `${Math.round(100 * share)} % of the job`, seconds(left)].filter(Boolean).join(', ');
}

/** @param {Job} job */
function stateText(job) {
  if (job.ended === null) return progressText(job);
  if (job.exit_code === 0) return `✓ done in ${Math.max(1, Math.round(job.ended - job.started))} s`;
  return inFolder(`${job.exit_code === 130 ? '■ stopped' : '✗ failed'}: ${job.line}`);
}

/** Of the whole job, not of its stage. @param {Job} job */
export const progressBar = (job) => h('progress', {max: 1, 'aria-label': `progress of job ${job.number}`,
  ...(Number.isFinite(job.progress?.share) ? {value: job.progress.share} : {})});

// ---- replies beside buttons ---------------------------------------------------------------------------------------

/** @type {Map<number, (text: string, kind: string) => void>} by number of the job */
const replies = new Map();

/** The reply to a click, beside the button: the state of the job that it started, or why there is none. */
export function replyArea() {
  const node = h('output', {class: 'reply'}), requests = new LatestRequest();
  let answered = null; // number of the job
  const show = (text, kind = '') => { node.className = `reply ${kind}`; node.textContent = inFolder(text); };
  return {
    node,
    /** @param {any} body the filled form of a command */
    async start(body) {
      const turn = requests.begin();
      replies.delete(answered);
      show('starting …');
      try {
        const job = await turn.of(ask('/api/jobs', body)); // which is not aborted
        answered = job.number;
        replies.set(answered, show);
        keepJob(job);
      } catch (error) { show(error.message, 'error'); }
    },
  };
}

/** @param {Job} job */
function replyTo(job) {
  const kind = job.ended === null ? '' : job.exit_code ? 'error' : 'good';
  replies.get(job.number)?.(`Job ${job.number}: ${stateText(job)}`, kind);
}

/** A button that starts a job, with its reply. @param {string} text @param {() => any} body */
export function jobButton(text, body, attributes = {}) {
  const reply = replyArea();
  return [button(text, () => reply.start(body()), attributes), reply.node];
}

/** @param {Job} job */
function keepJob(job) {
  const listed = state.jobs.find((other) => other.number === job.number);
  if (!listed) showJobs([{...job, progress: null}, ...state.jobs]);
  else if (listed.ended !== null) finished(listed); // it had ended before the answer to its start came
}

// ---- the output of a command below its form -----------------------------------------------------------------------

/** What the newest job of a command has printed, also while it runs. */
export class Printed {
  /** @param {string} command @param {(job: Job, state: string) => void} [printed] is given the job */
  constructor(command, printed = () => {}) {
    this.words = command.split(' ');
    this.printed = printed;
    this.requests = new LatestRequest();
    this.key = null; // of the output that is shown
    this.heading = h('h3', {});
    this.text = h('pre', {class: 'printed', tabindex: 0, 'aria-label': `output of ${command}`});
    this.node = h('div', {hidden: true, 'data-printed': command}, this.heading, this.text);
    onJobs(() => this.update());
  }

  async update() {
    const job = state.jobs.find((job) => this.words.every((word, index) => job.arguments[index] === word));
    if (!job) return;
    this.heading.textContent = `Job ${job.number}: ${stateText(job)}`;
    const key = JSON.stringify([job.number, job.ended, job.printed]);
    if (key === this.key) return;
    this.key = key;
    this.printed(job, stateText(job));
    const turn = this.requests.begin();
    try {
      const {log} = await turn.ask(`/api/jobs/${job.number}/log`);
      this.text.textContent = inFolder(log);
      this.node.hidden = !log;
    } catch (error) { this.text.textContent = error.message; }
  }
}

// ---- questions of jobs --------------------------------------------------------------------------------------------

const questionKey = (job) => `${job.number} ${job.question.number}`;

/** A job asks before it moves something; "No" comes first. The buttons stay until the question is settled. */
function questionRow(job) {
  const {number, text} = job.question, reply = h('output', {class: 'reply'});
  const answer = (yes) => async () => {
    reply.textContent = 'sending …';
    try {
      await ask('/api/answer', {job: job.number, question: number, yes});
    } catch (error) { reply.textContent = error.message; }
  };
  return h('div', {'data-question': questionKey(job)}, h('strong', {}, `Job ${job.number} asks: `), inFolder(text),
    h('span', {class: 'buttons'}, button('No', answer(false), {class: 'primary'}), button('Yes', answer(true)), reply));
}

/** @param {Job[]} jobs */
function showQuestions(jobs) {
  const list = $('questions'), asking = jobs.filter((job) => job.question);
  const rows = /** @type {HTMLElement[]} */ ([...list.children]);
  for (const row of rows) if (!asking.some((job) => questionKey(job) === row.dataset.question)) row.remove();
  for (const job of asking) {
    if (!rows.some((row) => row.dataset.question === questionKey(job))) list.append(questionRow(job));
  }
}

// ---- the drawer ---------------------------------------------------------------------------------------------------

/** @type {Map<number, {text: string, requests: LatestRequest}>} outputs that are open, by number of the job */
const opened = new Map();

async function showOutput(job) {
  const output = opened.get(job);
  const {log} = await output.requests.begin().ask(`/api/jobs/${job}/log`);
  output.text = log || 'no output yet';
  const shown = $('job-list').querySelector(`[data-job="${job}"] pre`);
  if (shown) shown.textContent = output.text;
}

/** @param {Job} job */
function jobRow(job) {
  const act = (action) => async ({target}) => {
    const reply = target.parentElement.querySelector('.reply');
    reply.textContent = {stop: 'stopping …', again: 'starting …'}[action];
    try {
      keepJob(await ask(`/api/jobs/${job.number}/${action}`, {}));
      if (action === 'again') reply.textContent = 'started above';
    } catch (error) { reply.textContent = inFolder(error.message); }
  };
  const look = ({target}) => {
    if (!opened.delete(job.number)) {
      opened.set(job.number, {text: '', requests: new LatestRequest()});
      showOutput(job.number);
    }
    target.closest('li').querySelector('pre').hidden = !opened.has(job.number);
  };
  const running = job.ended === null;
  return h('li', {'data-job': job.number, 'data-state': running ? 'running' : job.exit_code},
    h('div', {}, h('code', {}, job.command)),
    h('div', {class: `state ${!running && job.exit_code ? 'error' : ''}`}, stateText(job),
      running ? progressBar(job) : ''),
    h('div', {class: 'buttons'},
      running ? button('Stop', act('stop'), {disabled: job.stopping}) :
        button(job.exit_code ? 'Continue' : 'Again', act('again')),
      whereToWatch(job) ? button('Watch', () => watch(job)) : '',
      button('Output', look),
      button('Copy', () => navigator.clipboard.writeText(job.command)),
      h('output', {class: 'reply'}, job.stopping ? 'stopping …' : '')),
    h('pre', {hidden: !opened.has(job.number), tabindex: 0}, opened.get(job.number)?.text ?? ''));
}

// Closed, the drawer shows the job that runs, or the last one.
function showLine(jobs) {
  const running = jobs.filter((job) => job.ended === null), job = running[0] ?? jobs[0];
  const more = running.length > 1 ? ` and ${running.length - 1} more` : '';
  const line = job ? `job ${job.number}, ${job.arguments[0]}: ${stateText(job)}${more}` : 'none yet';
  $('jobs-line').replaceChildren(h('span', {}, line), ...(running.length ? [progressBar(job)] : []));
}

function openDrawer(open) {
  $('jobs-toggle').setAttribute('aria-expanded', String(open));
  $('job-list').hidden = !open;
}
$('jobs-toggle').addEventListener('click', () => openDrawer($('job-list').hidden));

/**
 * Puts the row of a job into its place; a button that has the focus keeps it.
 * @param {Job} job
 * @param {number} index
 */
function placeRow(job, index) {
  const list = $('job-list'), row = jobRow(job);
  const item = /** @type {HTMLElement | null} */ (list.querySelector(`[data-job="${job.number}"]`));
  const focused = item?.contains(document.activeElement) ? document.activeElement.textContent : null;
  if (item && list.children[index] === item) {
    item.dataset.state = row.dataset.state;
    refill(item, [...row.children]);
  } else {
    item?.remove();
    list.insertBefore(row, list.children[index] ?? null);
  }
  const placed = list.children[index];
  if (focused && !placed.contains(document.activeElement)) {
    [...placed.querySelectorAll('button')].find((candidate) => candidate.textContent === focused)?.focus();
  }
  if (opened.has(job.number)) showOutput(job.number);
  return Boolean(item);
}

/** @param {Job[]} jobs the newest first */
export function showJobs(jobs) {
  const before = new Map(state.jobs.map((job) => [job.number, JSON.stringify(job)]));
  state.jobs = jobs;
  for (const job of jobs) replyTo(job);
  showQuestions(jobs);
  showLine(jobs);
  const list = $('job-list'), shown = jobs.slice(0, MOST_JOBS);
  if (!jobs.length) {
    list.replaceChildren(h('li', {class: 'quiet'},
      'None yet. Jobs that you start appear here; they continue when this page is closed.'));
    return;
  }
  for (const item of /** @type {HTMLElement[]} */ ([...list.children])) {
    if (!shown.some((job) => String(job.number) === item.dataset.job)) item.remove();
  }
  shown.forEach((job, index) => {
    const item = list.children[index]?.getAttribute('data-job') === String(job.number);
    if (item && before.get(job.number) === JSON.stringify(job)) return;
    const wasListed = placeRow(job, index);
    if (job.ended !== null && wasListed) finished(job);
  });
  if (state.workspace) for (const act of listeners) act();
}

/** Selects the result of a finished job in the step that shows it. @param {Job} job */
function finished(job) {
  if (job.exit_code !== 0) return;
  results[job.arguments[0]]?.(job.writes.map((path) => path.replace(`${state.workspace.root}/`, '')));
  if (state.workspace) refresh(); // the list of files may have arrived before the end of the job
}
