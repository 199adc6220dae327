// SPDX-License-Identifier: Apache-2.0
// The page of the workbench. It shows what the server reads from files and stores nothing itself.

import {LEADS, TERMS, TERMS_OF} from './explain.js';
import {cursor, darkScheme, draw, erase, seen} from './figures.js';
import {live, watchable} from './live_view.js';
import {overlay} from './overlay.js';
import {Impact, replayIn} from './picture.js';
import {$, ask, commandLine, fill, fitAll, fixed, h, inFolder, labelled, messageArea, number, plain, query, Questions, refill, seconds, slug, state, stem, table, Tabs, unit} from './tools.js';

// ---- explanations ------------------------------------------------------------------------------------------------

const ABOUT = {
  predict: {title: 'Impact map', text: 'Maps the velocities just before an impact to those just after it: rigid bodies, instantaneous, ' +
    'finite forces neglected. B is the reflected inertia of the motors: B_θ with the torque loop, B_ρ of the rotors without it.',
    equation: '(M + B)(v⁺ − v⁻) = J_cᵀ Λ\nw = Jₙ v⁺ + e min(Jₙ v⁻, 0)\n0 ≤ Λₙ ⊥ w ≥ 0\n|Λₜ| ≤ µ Λₙ, against sliding',
    units: 'm/s, rad/s; impulses in N s; axes of the world frame', page: 'physics.md'},
  measure: {title: 'Trials', text: 'A trial is one hit and the push after it, recorded as one bag. A campaign repeats it for ' +
    'post-impact references below and above the prediction. Run an interrupted campaign again to continue it.',
    equation: 'a_fb,net = ∫ a_fb dt from T_nom − 0.1 s to T_nom + 0.6 s', units: 'none for scales (reference over prediction)',
    page: 'bags.md'},
  design: {title: 'A plan of trials', text: 'Trials that the cell can run are simulated under every explanation. Chosen are those that raise the ' +
    'probability most that the next diagnosis distinguishes two explanations. With a diagnosis the plan splits its ties; without one it looks for the missing effect.',
    units: 'probabilities in percent', page: 'design.md'},
  limits: {title: 'Speed limit', text: 'The hit is simulated with draws of what is not known exactly: the uncertainties of the scenario, stiffness and ' +
    'damping, and the difference between simulators. A speed is allowed if all bounds hold in 99 % of them. A reflex stops the robot by itself.',
    units: 'closing speed along the normal of the pad, m/s', page: 'limits.md'},
  designs: {title: 'Design study', text: 'The hit of every combination is predicted. Each value has an interval from the uncertainties of the scenario, ' +
    'and each rank a range.', units: 'impulse in N s, speeds in m/s; joint jump over the velocity limit', page: 'design_study.md'},
  rehearse: {title: 'Rehearsal', text: 'Arming, cell, controller, brake and watchdog are those that a robot meets; the driver is a stand-in with the ' +
    'rates, latencies and limits of its profile. A negative margin fails the rehearsal.', units: 'beside each number', page: 'limits.md#rehearsal'},
  import: {title: 'Import', text: 'Positions lie within the limits of the robot, velocities are their derivative, torques are those of weight and inertia. ' +
    'ASSUMED marks what nothing shows: look at those values.', units: 'as in the files; the mapping names them', page: 'your_data.md'},
  impacts: {title: 'Impacts', text: 'Positions on both sides of an impact are fitted: parabolas of joints, sliding or flight of the object. Whatever gives ' +
    'no row is listed with the reason.', units: 'in the header of each column', page: 'your_data.md'},
  follow: {title: 'Follow', text: 'The first hits teach the scatter. A change is announced with its first hit, its evidence and the effects that explain it. ' +
    'At most one alarm in 10,000 hits is false where noise is Gaussian, as large as in the first hits; a day that drifts raises more.', units: 'beside each number', page: 'following.md'},
  evidence: {title: 'Evidence', text: 'A package holds the model, its diagnosis, digests of the measurements, and versions. A merge pools each parameter ' +
    'and names the laboratory that does not agree.', units: 'those of the parameters', page: 'exchange.md'},
  laboratory: {title: 'Runs of another controller', text: 'A robot that pushes a box with its own controller: joint states, torque, ' +
    'and motion capture of the box are enough. Each run has a twin: an open-loop simulation driven by the recorded torque.',
    units: 'the mapping names the unit of each signal', page: 'your_data.md'},
  compare: {title: 'Score', text: 'One number for all signals and conditions, as a multiple of repeatability (the scatter of repeats). The cells of ' +
    'the map show where the model fails: measured minus model.',
    equation: 'score² = Σ r² / Σ (s²/n + d²)', units: 'multiples of repeatability; differences in their own unit',
    page: 'diagnosis.md'},
  diagnose: {title: 'Diagnosis', text: 'Every effect of the library is fitted and judged by its held-out error: the error on conditions ' +
    'that the search has not seen.', equation: 'held-out error: before → after', units: 'multiples of repeatability',
    page: 'diagnosis.md'},
  add: {title: 'A better model', text: 'The parent model with the effects that were found and their estimates. Model files are never overwritten and name their ' +
    'parent. Faults of the readings go into calibration.yaml beside the measurements. An effect of your own is an arithmetic formula.',
    units: 'beside each parameter', page: 'effects.md'},
  overlay: {title: 'Overlay', text: 'Runs lie over each other with their impacts at time 0. A pinned run stays chosen and on top, whatever ' +
    'the filter says. Estimates have their 95 % intervals.', units: 'beside each axis', page: 'workbench.md'},
  history: {title: 'History', text: 'How the error fell from model to model: with the parameters of the file, and held out, where ' +
    'fitting noise does not help.', units: 'multiples of repeatability', page: 'diagnosis.md'},
  investigate: {title: 'Investigation', text: 'Each round designs trials, predicts and measures them, compares, diagnoses, and adds the missing ' +
    'effect. It ends when nothing is missing, a law holds, or the trials are spent; it says where it cannot decide. The same folder goes on.',
    units: 'multiples of repeatability', page: 'investigation.md'},
};

function drawing(markup) {
  const made = document.createElement('template');
  made.innerHTML = markup;
  return made.content;
}

const termsOf = (step) => TERMS_OF[step].map((key) => h('figure', {class: 'term'}, drawing(TERMS[key].svg),
  h('figcaption', {}, h('b', {}, TERMS[key].name), `: ${TERMS[key].text}`)));

// The first two lines of a step, or of a tab: what it is; what it says, and what comes next.
const said = Object.fromEntries(Object.keys(LEADS).map((key) => [key, h('span', {'data-says': key}, LEADS[key].empty)]));

function lead(key) {
  const {what, next, to} = LEADS[key];
  return h('div', {class: 'lead'}, h('p', {}, what), h('p', {}, said[key], ' Next: ', h('a', {href: `#${to}`}, next), '.'));
}

function says(key, text) { said[key].textContent = text || LEADS[key].empty; }

function showAbout({title, text, equation, units, page, command, facts = [], actions = [], terms = []}) {
  $('right').replaceChildren(
    h('h2', {}, title), text ? h('p', {}, text) : '',
    equation ? h('p', {}, ...equation.split('\n').flatMap((line) => [h('code', {}, line), h('br')])) : '',
    units ? h('p', {class: 'note'}, `Units: ${units}`) : '',
    ...facts.map((fact) => h('p', {}, fact)),
    command ? h('p', {class: 'note'}, 'In a terminal: ', h('code', {}, command)) : '',
    actions.length ? h('div', {class: 'actions'}, ...actions) : '',
    page ? h('p', {}, h('a', {href: `#manual/${page}`, onclick: (event) => { event.preventDefault(); openManual(page); }},
      'In the manual')) : '', ...terms,
  );
}

const manual = new Questions();

async function openManual(name) {
  const [page, anchor] = name.split('#');
  try {
    const {html} = await manual.begin().ask(`/manual/${page}`);
    const article = $('manual-page');
    article.innerHTML = html;
    for (const image of article.querySelectorAll('img')) image.src = `/manual/${image.getAttribute('src')}`;
    for (const link of article.querySelectorAll('a[href]')) {
      const target = link.getAttribute('href');
      if (/^[a-z_]+\.md/.test(target)) {
        link.addEventListener('click', (event) => { event.preventDefault(); openManual(target); });
      } else if (!target.startsWith('http')) link.removeAttribute('href');
    }
    if (!$('manual').open) $('manual').showModal();
    $('manual').scrollTop = 0;
    if (anchor) document.getElementById(anchor)?.scrollIntoView();
  } catch (error) { showAbout({title: 'Manual', text: error.message}); }
}

// ---- forms of commands -----------------------------------------------------------------------------------------------

const FORMS = await ask('/api/forms'); // fields of every form, from the declarations of the commands

// RUNS: campaigns, folders of several, and described recordings of laboratories.
function runsChoices() {
  const labs = state.workspace.laboratories.filter((lab) => lab.experiment && !lab.error);
  return [...plain(state.workspace.runs), ...labs.map((lab) => ({value: lab.path, text: `${lab.path} (laboratory)`}))];
}

const experimentOf = (runs) => state.workspace.laboratories.find((lab) => lab.path === runs)?.experiment ?? '';

// What a field can be, by its name or by its kind: what lies in the folder.
const CHOICES = {
  plan: () => plain(state.workspace.plans),
  impacts: () => plain(state.workspace.tables),
  calibration: () => plain(state.workspace.calibrations),
  package: () => plain(state.workspace.packages),
  packages: () => plain(state.workspace.packages),
  files: () => state.workspace.laboratories.filter((lab) => lab.recordings.length).map(({path, experiment}) =>
    ({value: path, text: `${path}${experiment ? ' (described)' : ''}`, on: !experiment && state.workspace.laboratories.length === 1})),
  robot: () => plain(state.workspace.robots),
  robots: (one) => [...new Set([...one.default, ...state.workspace.robots])].map((value) => ({value, text: value, on: one.default.includes(value)})),
  folder: runsChoices,
  scenario: () => plain(state.workspace.scenarios),
  runs: runsChoices,
  model: () => state.workspace.models.filter((model) => !model.error).map((model) => ({value: model.path, text: model.name})),
  experiment: () => plain(state.workspace.laboratories.map((lab) => lab.experiment).filter(Boolean)),
  diagnosis: () => state.workspace.diagnoses.map(({path, verdict, model}) => ({value: path, text: `${path}: ${model}, ${verdict}`})),
  formulas: () => plain(state.workspace.formulas),
};

const choicesOf = (one) => one.choices.length || one.kind === 'text' ? undefined : CHOICES[one.name] ?? (one.many ? undefined : CHOICES[one.kind]);

const CUT_OFF = 18; // characters that a narrow field shows

// The control of one field: its node, its value (undefined: left out), and how to set value and choices.
function fieldOf(one, id, offered) {
  const text = `${one.label}${unit(one.unit) ? ` [${one.unit}]` : ''}`, title = one.help;
  const blank = one.required ? '' : one.otherwise || (one.default ?? 'none');
  if (one.kind === 'switch') {
    const input = h('input', {type: 'checkbox', id});
    return {node: h('label', {class: 'tick long', title}, input, one.label), value: () => input.checked || undefined,
      set: (value) => { input.checked = value; }, offer() {}};
  }
  if (one.many && (offered || one.choices.length || choicesOf(one))) {
    const node = h('fieldset', {class: 'checks wide', id, title}, h('legend', {}, text));
    const offer = (choices) => { // what a step offers begins anew; of what lies in the folder the ticks stay
      const boxes = choices.map((choice) => h('label', {}, h('input', {type: 'checkbox', value: choice.value, checked: choice.on}), choice.text));
      if (offered) node.replaceChildren(node.firstChild, ...boxes); else refill(node, [node.firstChild, ...boxes]);
    };
    offer(one.choices.map((value) => ({value, text: value, on: one.default?.includes(value)})));
    return {node, set() {}, offer, value: () => [...node.querySelectorAll('input:checked')].map(({value}) => one.kind === 'number' ? Number(value) : value)};
  }
  if (offered || one.choices.length || choicesOf(one)) {
    const select = h('select', {id});
    const none = one.required || one.default ? [] : [{value: '', text: blank}];
    const offer = (choices, wanted) => fill(select, one.kind === 'runs' ? [...choices, ...none] : [...none, ...choices], wanted);
    if (one.choices.length) offer(plain(one.choices), one.default);
    return {node: labelled(text, select, {title}), control: select, offer, value: () => select.value || undefined,
      set: (value) => { select.value = value; }};
  }
  const numeric = !one.many && ['whole', 'number'].includes(one.kind);
  const input = h('input', {id, placeholder: one.many && one.default ? one.default.join(' ') : blank, ...(numeric ?
    {type: 'number', min: one.least, max: one.most, step: one.kind === 'whole' ? 1 : 0.05} : {})});
  if (numeric && one.default !== null) input.value = one.default;
  const parts = () => input.value.split(one.kind === 'setting' ? /\s+/ : /[\s,]+/).filter(Boolean);
  return {node: labelled(text, input, {title, class: one.kind.startsWith('new_') || blank.length > CUT_OFF ? 'long' : null}), control: input, offer() {},
    value: () => input.value === '' ? undefined : one.many ? parts() : numeric ? Number(input.value) : input.value,
    set: (value) => { input.value = value; }};
}

// The form of a command: the command is shown while the form is filled in, and run as a job on submit. `offers` names the
// fields whose choices a step gives, which follow from field `first`; `suggest` makes values of fields that the user has
// not filled in.
function commandForm(command, label, {offers = [], first = 'scenario', suggest = {}, ready = () => true} = {}) {
  const fields = Object.fromEntries(FORMS[command].fields.map((one) => [one.name,
    {one, ...fieldOf(one, `${command.replaceAll(' ', '-')}-${one.name}`, offers.includes(one.name))}]));
  const message = messageArea(), button = h('button', {class: 'primary', type: 'submit'}, label);
  const typed = new Set(), all = Object.values(fields), questions = new Questions();
  let before = null;
  const value = (name) => fields[name].value();
  const body = () => ready() ? {command, ...Object.fromEntries(all.map((field) => [field.one.name, field.value()]))} : null;
  const check = async () => {
    const turn = questions.begin();
    await turn.pause(150);
    const content = body();
    if (!content) { message.show(); button.disabled = true; return; }
    try {
      const {command: line} = await turn.ask('/api/command', content);
      message.command(line);
      button.disabled = false;
    } catch (error) { message.error(error.message); button.disabled = true; }
  };
  const refresh = () => {
    for (const [name, make] of Object.entries(suggest)) {
      if (!typed.has(name) && !fields[name].node.contains(document.activeElement)) fields[name].set(make());
    }
    const content = JSON.stringify(body() ?? null);
    if (content !== before) message.wait();
    before = content;
    check();
  };
  for (const [name, field] of Object.entries(fields)) {
    const changed = () => { // a name of results that is taken away is suggested again
      if (field.one.kind.startsWith('new_') && value(name) === undefined) typed.delete(name); else typed.add(name);
    };
    for (const event of ['input', 'change']) field.node.addEventListener(event, changed);
    field.node.addEventListener('focusin', () => showAbout({title: field.one.label, text: sentence(field.one.help),
      units: unit(field.one.unit), facts: [field.one.otherwise ? `Left out: ${field.one.otherwise}.` : ''].filter(Boolean),
      command: field.one.spelled}));
  }
  const place = ({one, node}) => one.name === first && !one.advanced ? 0 : node.classList.contains('wide') ? 2 : 1; // boxes last
  const offerAll = () => {
    for (const {one, offer} of all) if (choicesOf(one) && !offers.includes(one.name)) offer(choicesOf(one)(one));
  };
  const nodes = (advanced) => all.filter(({one}) => one.advanced === advanced).sort((a, b) => place(a) - place(b)).map(({node}) => node);
  const further = nodes(true);
  const reply = replyArea();
  const node = h('form', {novalidate: true, oninput: refresh, onchange: refresh, onsubmit: (event) => {
    event.preventDefault();
    reply.start(body());
  }}, h('div', {class: 'fields'}, ...nodes(false)),
  further.length ? h('details', {class: 'more'}, h('summary', {}, 'More options'), h('div', {class: 'fields'}, ...further)) : '',
  h('div', {class: 'actions'}, button, reply.node), message.node); // below the button, which must not move while it is clicked
  return {node, refresh, message, value, fields, control: (name) => fields[name].control,
    offer: (name, choices, wanted) => fields[name].offer(choices, wanted),
    choose(name, wanted) { offerAll(); typed.add(name); fields[name].set(wanted); refresh(); },
    update() { offerAll(); refresh(); }};
}

const sentence = (text) => `${text.charAt(0).toUpperCase()}${text.slice(1)}.`;

// Offers what the chosen scenario has: `offer` is given it.
function followScenario(form, offer) {
  const questions = new Questions();
  const choose = async (only = {}) => {
    const turn = questions.begin();
    form.found = null;
    form.refresh();
    try {
      const found = form.found = await turn.ask(`/api/scenario?${query({name: form.value('scenario')})}`);
      offer(found, only);
      form.refresh();
    } catch (error) { form.message.error(error.message); }
  };
  form.control('scenario').addEventListener('change', () => choose());
  return choose;
}

function keepJob(job) {
  if (!state.jobs.some((other) => other.number === job.number)) showJobs([{...job, progress: null}, ...state.jobs]);
}

// What became of a click, beside the button: the state of the job that it started, or why there is none.
const replies = new Map(); // by number of the job

function replyArea() {
  const node = h('output', {class: 'reply'}), questions = new Questions();
  let answered = null; // number of the job
  const show = (text, kind = '') => { node.className = `reply ${kind}`; node.textContent = inFolder(text); };
  return {
    node, show,
    async start(body) {
      const turn = questions.begin();
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

function answerBeside(job) {
  replies.get(job.number)?.(`Job ${job.number}: ${stateText(job)}`, job.ended === null ? '' : job.exit_code ? 'error' : 'good');
}

// A button that starts a job, with its reply.
function jobButton(text, body, attributes = {}) {
  const reply = replyArea();
  return [h('button', {type: 'button', ...attributes, onclick: () => reply.start(body())}, text), reply.node];
}

// Pages with one file name in the folder, of which the chosen one stands in the step; that of a job which ends comes first.
class Pages {
  constructor(id, label, page, opened = () => {}) {
    Object.assign(this, {page, onOpen: opened});
    this.select = h('select', {id: `${id}-page`, onchange: () => this.open()});
    this.result = h('div', {id: `${id}-result`});
    this.nodes = [labelled(label, this.select), this.result];
  }

  // Folders of the pages.
  folders() { return state.workspace.reports.filter((path) => path.endsWith(`/${this.page}`)).map((path) => path.slice(0, -this.page.length - 1)); }

  update() {
    const found = this.folders(), of = (folder) => state.workspace.stamps[`${folder}/${this.page}`];
    fill(this.select, plain(found), this.wanted && found.includes(this.wanted) ? this.wanted : undefined);
    this.select.parentElement.hidden = !found.length;
    if (this.select.value && (this.select.value !== this.opened || of(this.select.value) !== this.stamp)) this.open();
    if (this.wanted === this.select.value) this.wanted = null;
  }

  open() {
    const folder = this.opened = this.select.value;
    this.stamp = state.workspace.stamps[`${folder}/${this.page}`];
    this.result.replaceChildren(...wholeReport(`${folder}/${this.page}`, true));
    this.onOpen(folder);
  }
}

// What the newest job of a command has printed, also while it runs. `printed` is given the job.
class Printed {
  constructor(command, printed = () => {}) {
    Object.assign(this, {words: command.split(' '), onPrint: printed, questions: new Questions(), key: null});
    this.heading = h('h3', {});
    this.text = h('pre', {class: 'printed', tabindex: 0, 'aria-label': `output of ${command}`});
    this.node = h('div', {hidden: true, 'data-printed': command}, this.heading, this.text);
    Printed.all.push(this);
  }

  static all = [];

  async jobs() {
    const job = state.jobs.find((one) => this.words.every((word, place) => one.arguments[place] === word));
    if (!job) return;
    this.heading.textContent = `Job ${job.number}: ${stateText(job)}`;
    const key = JSON.stringify([job.number, job.ended, job.printed]);
    if (key === this.key) return;
    this.key = key;
    this.onPrint(job);
    const turn = this.questions.begin();
    try {
      const {log} = await turn.ask(`/api/jobs/${job.number}/log`);
      this.text.textContent = inFolder(log);
      this.node.hidden = !log;
    } catch (error) { this.text.textContent = error.message; }
  }
}

// ---- predict ----------------------------------------------------------------------------------------------------------

const sceneOf = (name, object) => ask(`/api/scene?${query({name, object})}`);

const predict = {
  values: {}, over: 'speed', wanted: null, busy: false, moving: false, sweep: null, question: null,
  scenarios: new Questions(),
  questions: new Questions(), // what is chosen above the sliders
  refinements: new Questions(), // of where the sliders rest

  build() {
    this.scenario = h('select', {id: 'predict-scenario', onchange: () => this.choose()});
    this.object = h('select', {id: 'predict-object', onchange: () => this.objectChosen()});
    this.case = h('select', {id: 'predict-case', onchange: () => this.anew()});
    this.model = h('select', {id: 'predict-model', onchange: () => this.anew()});
    this.inertia = h('select', {id: 'predict-inertia', onchange: () => this.anew()},
      new Option('B_θ (reduced)', 'reduced'), new Option('B_ρ (whole rotor)', 'rotor'), new Option('B = 0 (none)', 'zero'));
    this.arm = h('select', {id: 'predict-arm', onchange: () => this.anew()});
    this.scene = h('div', {class: 'scene', id: 'predict-scene'});
    this.impact = new Impact(this.scene, sceneOf);
    this.sliders = h('div', {class: 'sliders', id: 'sliders'});
    this.known = h('div', {class: 'sliders'});
    this.plot = h('div', {class: 'plot', id: 'predict-plot', role: 'img', 'aria-label': 'Velocity after the impact'});
    this.table = h('tbody');
    this.facts = h('p', {class: 'note', id: 'predict-facts'});
    this.budget = h('ul', {class: 'bars'});
    this.message = messageArea();
    this.numbers = h('div', {class: 'two', id: 'predict-numbers'},
      h('div', {}, h('div', {class: 'scroll'}, h('table', {id: 'predict-table'}, h('thead', {}, h('tr', {},
        ...['body, axis', 'before', 'after', '95 % interval'].map((text) => h('th', {scope: 'col'}, text)))), this.table)),
      this.facts),
      h('div', {}, h('h3', {}, 'Sources of the interval'), this.budget));
    this.plot.redrawn = () => { if (this.answer) this.paint(); };
    return h('div', {},
      h('div', {class: 'fields'}, labelled('scenario', this.scenario), labelled('object', this.object),
        labelled('case', this.case), labelled('model', this.model), labelled('motor inertia', this.inertia), labelled('arm in the figure', this.arm, {hidden: true})),
      h('div', {class: 'beside'}, this.scene, h('div', {}, this.sliders,
        h('details', {}, h('summary', {}, 'Uncertainty of the inputs (95 %)'), this.known))),
      this.plot, this.message.node, this.numbers,
      h('div', {class: 'actions'}, h('button', {type: 'button', onclick: () => this.reset()}, 'Reset sliders'),
        h('button', {type: 'button', onclick: () => this.measure()}, 'Measure this')));
  },

  async update() {
    fill(this.scenario, plain(state.workspace.scenarios), this.scenario.value || 'push');
    fill(this.model, CHOICES.model(), this.model.value || 'nominal');
    if (!this.chosen) await this.choose(); else if (this.model.value !== this.asked) this.anew();
  },

  async choose() {
    const name = this.chosen = this.scenario.value, turn = this.scenarios.begin();
    this.found = null; // what is chosen meanwhile is asked with its answer
    this.clear();
    try {
      const found = this.found = await turn.ask(`/api/scenario?${query({name})}`);
      fill(this.object, Object.entries(found.objects).map(([value, one]) => ({value, text: `${one.label}, ${one.mass} kg`})),
        this.object.value || 'cat_food');
      fill(this.case, Object.entries(found.cases).map(([value, text]) => ({value, text})), this.case.value || 'case_2');
      fill(this.arm, plain(Object.keys(found.arms)));
      this.arm.parentElement.hidden = this.arm.options.length < 2;
      this.objectChosen();
    } catch (error) { this.failed(error); }
  },

  // The question has changed: no answer to the earlier one stays under the new headings, or comes later.
  clear() {
    this.refinements.begin();
    this.sweep = this.answer = this.question = this.wanted = null;
    this.busy = this.moving = false;
    this.message.show();
    this.table.replaceChildren();
    this.budget.replaceChildren();
    this.facts.textContent = 'Computing …';
    delete this.plot.dataset.shown;
    this.plot.style.minHeight = `${this.plot.offsetHeight}px`; // what is below stays where it is
    erase(this.plot);
    this.turn = this.questions.begin();
  },

  failed(error) {
    this.clear();
    this.numbers.removeAttribute('aria-busy');
    this.facts.textContent = '';
    this.message.error(error.message);
  },

  anew() { this.asked = this.model.value; this.clear(); this.again(); },

  objectChosen() {
    if (!this.found) return;
    this.values = {};
    this.impact.ahead(this.scenario.value, this.object.value);
    const all = this.found.sliders[this.object.value];
    this.over = all[0].key;
    const made = (slider) => {
      const output = h('output', {}, `${number(slider.value)}${unit(slider.unit)}`);
      const input = h('input', {type: 'range', min: slider.low, max: slider.high, step: (slider.high - slider.low) / 200,
        value: slider.value, 'data-key': slider.key, title: slider.meaning, 'aria-label': `${slider.label} [${slider.unit}]`});
      input.value = slider.value;
      const label = h('label', {}, h('span', {}, slider.label), output, input);
      const moved = () => {
        const value = Number(input.value);
        this.values[slider.key] = value;
        label.classList.add('moved');
        output.textContent = `${number(value)}${unit(slider.unit)}`;
        if (slider.known && this.sweep) { this.sweep = {...this.sweep, low: [], high: []}; }
        if (this.over !== slider.key && !slider.known) { this.over = slider.key; this.sweep = null; }
        this.moving = true;
        this.again();
      };
      input.addEventListener('input', moved);
      input.addEventListener('change', () => this.rest());
      input.addEventListener('focus', () => showAbout({title: slider.label, text: slider.meaning, page: slider.page,
        facts: [`Scenario: ${number(slider.value)}${unit(slider.unit)}; key ${slider.key}.`], equation: ABOUT.predict.equation}));
      return label;
    };
    this.sliders.replaceChildren(...all.filter((one) => !one.known).map(made));
    this.known.replaceChildren(...all.filter((one) => one.known).map(made));
    this.anew();
  },

  reset() { this.objectChosen(); },

  // Velocities, with an interval from few draws. One question is under way at a time, and only the newest waits.
  async again() {
    if (!this.found) return;
    this.refinements.begin();
    this.wanted = {scenario: this.scenario.value, object: this.object.value, case: this.case.value, arm: this.arm.value, model: this.model.value,
      motor_inertia: this.inertia.value, values: {...this.values}, moving: true};
    this.message.wait();
    this.numbers.setAttribute('aria-busy', 'true');
    if (this.busy) return;
    this.busy = true;
    const {turn} = this;
    while (this.wanted) {
      const question = this.wanted;
      this.wanted = null;
      try {
        this.show(await turn.ask('/api/predict', question), question);
        this.question = question;
      } catch (error) { if (!this.wanted) this.failed(error); }
    }
    this.busy = false;
    if (!this.moving) this.refine();
  },

  // A slider was let go.
  rest() {
    this.moving = false;
    if (!this.busy) this.refine();
  },

  // What takes longer: the interval of many draws with its budget, and then the curves over a slider.
  async refine() {
    if (!this.question) return;
    const turn = this.refinements.begin(), question = {...this.question, moving: false};
    await turn.painted();
    try {
      this.show(await this.undisturbed(turn, '/api/predict', question), question);
      await turn.painted();
      this.sweep = await this.undisturbed(turn, '/api/sweep', {...question, over: this.over});
      this.place(question);
    } catch (error) { this.failed(error); }
  },

  // An answer that no question of another tab has stopped.
  async undisturbed(turn, path, question) {
    for (;;) {
      const answer = await turn.ask(path, question);
      if (!answer.superseded) return answer;
      await turn.pause(300);
    }
  },

  show(answer, question) {
    this.answer = answer;
    this.message.command(answer.command);
    this.table.replaceChildren(...answer.rows.filter((row) => row.main || Math.max(Math.abs(row.before), Math.abs(row.after)) > 5e-4)
      .map((row) => h('tr', {class: row.main ? 'main' : ''}, h('td', {}, `${row.body}, ${row.axis}`), h('td', {}, fixed(row.before)),
        h('td', {}, fixed(row.after)), h('td', {}, row.low === null ? '–' : `${fixed(row.low)} … ${fixed(row.high)}`))));
    const impulses = Object.entries(answer.impulses), several = impulses.length > 1;
    const pushed = impulses.map(([arm, values]) => `${several ? `${arm} ` : ''}[${values.map((value) => fixed(value)).join(', ')}]`).join(', ');
    const method = answer.moving ? '; interval from few draws while a slider moves' : answer.interval ? `; interval ${({monte_carlo: 'Monte Carlo'}[answer.interval.method] ?? answer.interval.method.replace('_', ' '))}, ${answer.interval.draws} draws` : '';
    this.facts.textContent = `m/s. Impulse of the pad${several ? 's' : ''} on the object ${pushed} N s${method}. ${answer.note}`;
    this.numbers.removeAttribute('aria-busy');
    this.plot.style.minHeight = '';
    this.budget.classList.toggle('stale', answer.moving); // too few draws for shares
    if (!answer.moving) this.budget.replaceChildren(...answer.budget.slice(0, 7).map((one) => h('li', {}, h('span', {}, one.source),
      h('i', {style: `width: ${(100 * one.share).toFixed(1)}%`}), h('span', {}, `${Math.round(100 * one.share)} %`))));
    const main = answer.rows.filter((row) => row.main), shown = (row) => `${row.body} ${fixed(row.before, 2)} → ${fixed(row.after, 2)} m/s`;
    this.turn.of(this.impact.draw(question.scenario, question.object, answer.moment)).catch((error) => { this.scene.textContent = error.message; });
    says('predict/impact', `${main.map(shown).join(', ')}, along ${answer.axis}.`);
    this.place(question);
  },

  // The row of the figure's body.
  row() { return this.answer.rows.find((one) => one.main && one.body === this.answer.arm); },

  // Markers of the current values: shapes, which Plotly moves without computing lines and axes again.
  marks() {
    const slider = this.slider(), x = this.values[slider.key] ?? slider.value;
    const row = this.row(), object = this.answer.rows.find((one) => one.main && one.body === 'object');
    const dot = (y, size, colour) => ({type: 'circle', xsizemode: 'pixel', ysizemode: 'pixel', xanchor: x, yanchor: y, x0: -size, x1: size,
      y0: -size, y1: size, fillcolor: seen(colour), line: {width: 0}});
    const bar = row.low === null ? [] : [{type: 'line', x0: x, x1: x, y0: row.low, y1: row.high, line: {width: 4, color: seen('#000000')}}];
    return [...bar, dot(row.after, 6, '#000000'), dot(object.after, 4, '#E69F00')];
  },

  slider() { return this.found.sliders[this.object.value].find((one) => one.key === this.over); },

  async place(question) {
    const {turn} = this;
    if (!this.plot.data) await turn.frame(); // numbers are painted before the library of the figures comes
    await turn.of(question.moving && this.onlyMarksMove() ? Plotly.relayout(this.plot, {shapes: this.marks()}) : this.paint());
    this.plot.dataset.shown = JSON.stringify(question.values);
  },

  // Whether the figure has the axes and curves of the answer, and room for its markers: they move ten times faster alone.
  onlyMarksMove() {
    if (!this.plot.data || this.painted.over !== this.over || this.painted.sweep !== this.sweep) return false;
    const [low, high] = this.plot.layout.yaxis.range;
    return this.marks().every(({yanchor, y0, y1}) => (yanchor === undefined ? [y0, y1] : [yanchor]).every((one) => low <= one && one <= high));
  },

  // The impact map over one slider, with markers of the current values.
  paint() {
    this.painted = {over: this.over, sweep: this.sweep};
    const slider = this.slider(), key = slider.key, row = this.row();
    const lines = this.sweep?.slider.key === key ? this.sweep : null;
    const data = [];
    if (lines) {
      data.push({x: [...lines.x, ...[...lines.x].reverse()], y: [...lines.high, ...[...lines.low].reverse()], fill: 'toself',
        fillcolor: 'rgba(86,180,233,0.28)', line: {width: 0}, name: '95 % interval', hoverinfo: 'skip', mode: 'lines'});
      for (const line of lines.lines) {
        data.push({x: lines.x, y: line.y, name: line.label, mode: 'lines', line: {color: line.colour, width: line.chosen ? 3 : 1.5,
          dash: line.chosen ? 'solid' : 'dash'}, hovertemplate: '%{y:.3f} m/s'});
      }
      data.push({x: lines.x, y: lines.object, name: 'object', mode: 'lines', line: {color: '#E69F00', width: 2, dash: 'dot'},
        hovertemplate: '%{y:.3f} m/s'});
    }
    for (const [name, colour] of [[`${row.body}, here`, '#000000'], ['object, here', '#E69F00']]) { // for the legend
      data.push({x: [null], y: [null], mode: 'markers', name, marker: {color: colour, size: 11}});
    }
    const below = 52 + 19 * Math.ceil(7 / Math.max(1, Math.floor((this.plot.clientWidth - 72) / 190))); // of the legend
    return draw(this.plot, {data, layout: {height: 250 + below, margin: {l: 60, r: 12, t: 10, b: below}, hovermode: 'closest', shapes: this.marks(),
      xaxis: {title: {text: `${slider.label} [${slider.unit}]`, standoff: 8}, range: [slider.low, slider.high], zeroline: false},
      yaxis: {title: {text: `v<sub>${this.answer.axis}</sub> after the impact [m/s]`}, zeroline: true, automargin: true},
      legend: {orientation: 'h', yref: 'container', y: 0, yanchor: 'bottom', x: 0, xanchor: 'left', font: {size: 11}}}});
  },

  measure() {
    measure.wanted = {scenario: this.scenario.value, object: this.object.value, case: this.case.value};
    go('measure', 'campaign');
  },
};

// Objects and cases of the chosen scenario: those of one hit, or the first of several.
const offerHits = (form) => (found) => {
  const all = (kind, entries) => form.fields[`${kind}s`] ?
    form.offer(`${kind}s`, entries.map(([value, text], place) => ({value, text, on: place === 0}))) :
    form.fields[kind] && form.offer(kind, [...(form.fields[kind].one.required ? [] : [{value: '', text: form.fields[kind].one.otherwise}]),
      ...entries.map(([value, text]) => ({value, text}))]);
  all('object', Object.entries(found.objects).map(([key, one]) => [key, one.label]));
  all('case', Object.entries(found.cases));
};

// The form of a command about the hits of a scenario, which asks for the scenario when it is first in sight.
function hitsForm(command, label, suggest = {}) {
  const names = FORMS[command].fields.map((one) => one.name);
  const form = commandForm(command, label, {offers: ['object', 'objects', 'case', 'cases'].filter((name) => names.includes(name)),
    suggest, ready: () => form.found});
  const choose = followScenario(form, offerHits(form)), update = form.update;
  let asked = false;
  return Object.assign(form, {update() {
    update();
    if (!asked) { asked = true; form.choose('scenario', 'push'); choose(); }
  }});
}

const limits = {
  build() {
    this.form = hitsForm('limits', 'Compute the limits', {output: () => `limits/${stem(this.form.value('scenario') ?? 'push')}`});
    this.pages = new Pages('limits', 'speed limits', 'limits.html', (folder) => this.say(folder));
    return h('div', {}, this.form.node, ...this.pages.nodes);
  },

  update() { this.form.update(); this.pages.update(); },

  async say(folder) {
    const found = await ask(`/files/${folder}/limits.json`), least = [...found.limits].sort((a, b) => a.limit_m_s - b.limit_m_s)[0];
    says('predict/limits', `${found.scenario}: ${least.object}, ${least.case} may hit at ${number(least.limit_m_s)} m/s, ${number(least.planned_m_s)} m/s are planned.`);
  },
};

const designs = {
  build() {
    this.form = hitsForm('study-design', 'Rank the designs', {output: () => free((count) => `designs/${count}`, state.workspace ? this.pages.folders() : [])});
    this.pages = new Pages('study-design', 'design study', 'design_study.html', (folder) => says('predict/designs', `The page below ranks the designs of ${folder}.`));
    return h('div', {}, this.form.node, ...this.pages.nodes);
  },

  update() { this.form.update(); this.pages.update(); },
};

// ---- measure ------------------------------------------------------------------------------------------------------------

const trialName = (object, case_, scale = 1) => `${object}__${case_}__s${scale.toFixed(3)}__r0`;

const measure = {
  questions: new Questions(), // of the picture

  build() {
    const parts = {campaign: ['Campaign', this.campaign()], trial: ['Single trial', this.trial()], design: ['Design', design.build()],
      rehearse: ['Rehearsal', rehearse.build()], recorded: ['Recorded trials', recorded.build()], live: ['Live', live.build()],
      blind: ['Practise', this.blind()]};
    this.tabs = new Tabs(parts);
    this.scene = h('div', {class: 'scene', id: 'measure-scene'});
    this.impact = new Impact(this.scene, sceneOf);
    for (const form of [this.form, this.trialForm]) form.node.addEventListener('change', () => this.picture());
    return h('section', {}, h('h2', {}, 'Measure'), this.tabs.list, this.tabs.lead,
      this.place = h('div', {class: 'beside'}, h('div', {}, ...this.tabs.panels), this.scene), this.trialView.node);
  },

  // Nodes are watched while their tab is in sight.
  look() { live.show(state.step === 'measure' && this.tabs.chosen === 'live'); },

  // Where the trials of a job are seen.
  watch(job) {
    const folder = inFolder(job.writes[0] ?? '');
    go('measure', watchable(job) ?? 'recorded');
    recorded.wanted = state.workspace.campaigns.find((one) => `${one.path}/`.startsWith(`${folder}/`))?.path;
    recorded.update();
  },

  // The impact that the form asks for, as the nominal model predicts it.
  async picture() {
    if (this.scene.hidden || state.step !== 'measure') {
      this.questions.begin();
      this.pictured = null;
      return;
    }
    const form = this.tabs.chosen === 'trial' ? this.trialForm : this.form;
    const one = (value) => Array.isArray(value) ? value[0] : value;
    const question = {scenario: form.value('scenario'), object: one(form.value('objects' in form.fields ? 'objects' : 'object')),
      case: one(form.value('cases' in form.fields ? 'cases' : 'case'))};
    if (!form.found || !question.object || !question.case || JSON.stringify(question) === this.pictured) return;
    this.pictured = JSON.stringify(question);
    const turn = this.questions.begin();
    try {
      const {moment} = await turn.ask('/api/impact', question);
      await turn.of(this.impact.draw(question.scenario, question.object, moment));
    } catch (error) { this.pictured = null; this.scene.title = error.message; }
  },

  campaign() {
    const form = this.form = commandForm('campaign', 'Start the campaign', {offers: ['objects', 'cases', 'scales'], ready: () => form.found,
      suggest: {trials: () => 2, output: () => `campaigns/${stem(form.value('scenario') ?? 'push')}${this.only ? `_${this.only}` : ''}`}});
    // Number of trials, and whether an analysis needs more.
    const count = h('p', {class: 'note', id: 'campaign-count', 'aria-live': 'polite'});
    const counted = () => {
      const [some, ways, levels] = ['objects', 'cases', 'scales'].map((name) => form.value(name).length);
      const trials = form.value('trials') ?? form.found?.trials, total = some * ways * levels * trials;
      const few = form.found?.hits && total && (levels < 2 || levels * trials < 3);
      count.textContent = total ? `${total} trial${total === 1 ? '' : 's'}.${few ? ' Analyze needs at least two references over the ' +
        'prediction, and three trials of each object and case; Compare and Diagnose do not.' : ''}` : '';
    };
    for (const event of ['input', 'change']) form.node.addEventListener(event, counted);
    this.choose = followScenario(form, (found, only) => {
      const chosen = (all, one) => all.map(([value, text], index) => ({value, text, on: one ? value === one : index < 1}));
      this.only = only.object;
      form.offer('objects', chosen(Object.entries(found.objects).map(([key, one]) => [key, one.label]), only.object));
      form.offer('cases', chosen(Object.entries(found.cases), only.case));
      form.offer('scales', found.scales.map((scale) => ({value: scale, text: `${scale}`, on: true}))); // an estimate needs several
      counted();
      this.picture();
    });
    return h('div', {}, form.node, count);
  },

  trial() {
    const form = this.trialForm = commandForm('trial', 'Run the trial', {offers: ['object', 'case'], ready: () => form.found,
      suggest: {output: () => free((count) => count === 1 ? 'trials' : `trials_${count}`, this.takenFor(form))}});
    this.trialView = new TrialView('trial');
    this.chooseTrial = followScenario(form, (found) => {
      form.control('scale').max = found.largest_scale;
      form.offer('object', Object.entries(found.objects).map(([value, one]) => ({value, text: one.label})));
      form.offer('case', Object.entries(found.cases).map(([value, text]) => ({value, text})));
      this.picture();
    });
    return form.node;
  },

  // Folders into which the trial of the form cannot go: they have it already, or are of another kind.
  takenFor(form) {
    const {campaigns = [], laboratories = []} = state.workspace ?? {};
    const name = trialName(form.value('object'), form.value('case'), form.value('scale'));
    return [...campaigns.filter((one) => one.scenario || one.error || one.loose.includes(name)), ...laboratories].map(({path}) => path);
  },

  blind() {
    const form = this.blindForm = commandForm('blind make', 'Make the campaign',
      {suggest: {seed: () => 7, output: () => `blind_${form.value('seed')}`}});
    this.made = h('div', {id: 'practice'});
    return h('div', {}, form.node, this.made);
  },

  // Practice campaigns: diagnose one, and reveal what it hid.
  practice() {
    const found = state.workspace.blinds;
    if (JSON.stringify(found) === this.practised) return;
    this.practised = JSON.stringify(found);
    this.made.replaceChildren(...(found.length ? [h('h3', {}, 'Practice campaigns')] : []), ...found.map((path) => {
      const answer = h('div', {});
      return h('div', {'data-practice': path}, h('div', {class: 'actions'}, h('code', {}, path),
        h('button', {type: 'button', onclick: () => { go('diagnose'); diagnose.form.choose('runs', `${path}/runs`); }}, 'Diagnose'),
        h('button', {type: 'button', onclick: () => reveal(path, answer)}, 'Reveal')), answer);
    }));
  },

  // The newest single trial, in 3D and over time.
  newestTrial() {
    const job = state.jobs.find((one) => one.arguments[0] === 'trial' && one.ended !== null && one.exit_code < 2);
    this.trialView.node.hidden = this.tabs.chosen !== 'trial';
    if (!job || job.number === this.shown || state.step !== 'measure' || this.trialView.node.hidden) return;
    const [, , object, case_, ...flags] = job.arguments, folder = inFolder(job.writes[0]);
    const scale = Number(flags.includes('--scale') ? flags[flags.indexOf('--scale') + 1] : 1);
    const trial = trialName(object, case_, scale);
    if (!state.workspace.campaigns.some((one) => one.path === folder)) return;
    this.shown = job.number;
    says('measure/trial', `${trial.replaceAll('__', ' ')}, in ${folder}.`);
    this.trialView.open({path: `${folder}/${trial}`});
  },

  // What is in sight; the rest asks for nothing.
  update() {
    const own = {campaign: () => this.updateCampaign(), trial: () => this.updateTrial(), design: () => design.update(), rehearse: () => rehearse.update(),
      recorded: () => recorded.update(), live: () => {}, blind: () => { this.blindForm.update(); this.practice(); }};
    this.scene.hidden = !['campaign', 'trial'].includes(this.tabs.chosen);
    this.place.className = this.scene.hidden ? '' : 'beside';
    own[this.tabs.chosen]();
    this.newestTrial();
    this.picture();
  },

  updateCampaign() {
    const first = !this.form.asked, {wanted} = this;
    this.wanted = null;
    this.form.asked = true;
    if (first) this.form.offer('scenario', plain(state.workspace.scenarios), 'push');
    this.form.update();
    if (wanted) this.form.choose('scenario', wanted.scenario);
    if (first || wanted) this.choose(wanted ?? {});
  },

  updateTrial() {
    const first = !this.trialForm.asked;
    this.trialForm.asked = true;
    if (first) this.trialForm.offer('scenario', plain(state.workspace.scenarios), 'push');
    this.trialForm.update();
    if (first) this.chooseTrial();
  },
};

// ---- design of trials ---------------------------------------------------------------------------------------------------

// The first name that no file of the folder has.
function free(name, used) {
  let count = 1;
  while (used.includes(name(count))) count += 1;
  return name(count);
}

const design = {
  questions: new Questions(),

  build() {
    this.form = commandForm('design', 'Plan the trials', {first: 'budget', suggest: {budget: () => 18, runs: () => '',
      output: () => free((count) => `plans/plan_${count}.yaml`, state.workspace?.plans ?? [])}});
    this.file = h('select', {id: 'design-file', onchange: () => this.open()});
    this.result = h('div', {id: 'design-result'});
    return h('div', {}, this.form.node, labelled('plan', this.file), this.result);
  },

  // For what a diagnosis leaves open.
  after(diagnosis, runs) {
    go('measure', 'design');
    this.form.choose('after', diagnosis);
    if (runs) this.form.choose('runs', runs);
  },

  update() {
    this.form.update();
    const {plans, stamps} = state.workspace;
    fill(this.file, plain(plans), this.wanted && plans.includes(this.wanted) ? this.wanted : undefined);
    this.file.parentElement.hidden = !plans.length;
    if (this.file.value && (this.file.value !== this.opened || stamps[this.file.value] !== this.stamp)) this.open();
    if (this.wanted === this.file.value) this.wanted = null;
  },

  async open() {
    const path = this.opened = this.file.value, turn = this.questions.begin();
    this.stamp = state.workspace.stamps[path];
    this.result.replaceChildren(reading(path));
    try { this.show(await turn.ask(`/api/plan?${query({path})}`), path); } catch (error) { this.result.replaceChildren(mistake(error)); }
  },

  show(found, path) {
    says('measure/design', `${path}: ${found.trials} trials.`);
    const percent = (value) => `${(100 * value).toFixed(1)} %`;
    this.result.replaceChildren(h('p', {class: 'answer'}, h('b', {}, `${found.trials} trials`), found.summary),
      h('div', {class: 'actions'}, ...jobButton('Run the plan', () => ({command: 'campaign', plan: path, output: `campaigns/${stem(path)}`}), {class: 'primary'})),
      table('planned', ['trials', 'condition', 'what they add'], found.conditions.map((one) => [one.trials, one.what, one.adds])),
      ...(found.pairs.length ? [h('h3', {}, 'Probability that the next diagnosis distinguishes them, the least certain first'), table('pairs', ['explanation', 'against', 'before', 'after'],
        found.pairs.map((one) => [one.first, one.second, percent(one.before), percent(one.after)]), 2)] : []));
  },
};

const mistake = (error) => h('p', {class: 'error', role: 'alert'}, inFolder(error.message));

// ---- rehearsal ----------------------------------------------------------------------------------------------------------

const rehearse = {
  build() {
    this.form = hitsForm('rehearse', 'Rehearse', {output: () => `rehearsals/${stem(this.form.value('scenario') ?? 'push')}`});
    this.pages = new Pages('rehearse', 'rehearsal', 'rehearsal.html', (folder) => this.say(folder));
    return h('div', {}, this.form.node, ...this.pages.nodes);
  },

  update() { this.form.update(); this.pages.update(); },

  async say(folder) {
    const found = await ask(`/files/${folder}/rehearsal.json`);
    says('measure/rehearse', `${found.scenario}, ${found.object}, ${found.case}: ${found.passed ? 'passed' : 'not passed'}.`);
  },
};

// ---- recorded trials ----------------------------------------------------------------------------------------------------

// A recorded trial, or a run of a laboratory, in 3D and above its signals.
class TrialView {
  constructor(name) {
    Object.assign(this, {name, questions: new Questions()});
    this.node = h('div', {id: `${name}-shown`});
  }

  // `place`: the path of a trial, or the path of a laboratory with the name of a run.
  async open(place) {
    this.node.replaceChildren(reading(place.run ?? place.path));
    const turn = this.questions.begin();
    try {
      const found = await turn.ask(`/api/${place.run ? 'run' : 'trial'}?${query(place)}`);
      const replay = h('div', {id: `${this.name}-replay`});
      const plots = found.plots.map(({title, figure}) => ({title, figure, node: h('div', {class: 'plot', role: 'img', 'aria-label': title})}));
      this.node.replaceChildren(h('h3', {}, found.title), replay, ...plots.flatMap(({title, node}) => [h('h3', {}, title), node]),
        ...found.facts.map((text) => h('p', {class: 'note'}, text)));
      await turn.of(Promise.all(plots.map(({figure, node}) => draw(node, figure))));
      const made = await turn.of(replayIn(replay, found.replay, {onSeek: (time) => { for (const {node} of plots) cursor(node, time); }}));
      for (const {node} of plots) {
        node.on('plotly_click', ({points: [point]}) => made.seek(point.x));
        cursor(node, made.time);
      }
    } catch (error) { this.failed(error); }
  }

  failed(error) { this.node.replaceChildren(mistake(error)); }
}

// Trials of a campaign and runs of a laboratory: a click opens one. While a campaign runs, its newest trial is followed.
const recorded = {
  lists: new Questions(),

  build() {
    this.campaign = h('select', {id: 'recorded-campaign', onchange: () => this.list()});
    this.follow = h('input', {type: 'checkbox', id: 'recorded-follow', checked: true});
    this.none = emptyNote('No trials yet.');
    this.trials = h('ul', {class: 'chips', id: 'recorded-trials'});
    this.view = new TrialView('recorded');
    return h('div', {}, this.none, h('div', {class: 'fields'}, labelled('campaign or laboratory', this.campaign),
      h('label', {class: 'tick'}, this.follow, 'follow the newest while it runs')), this.trials, this.view.node);
  },

  // Campaigns with trials, and described laboratories, with the number of their recordings.
  folders() {
    const {campaigns, laboratories} = state.workspace;
    return [...campaigns.filter((one) => !one.error && one.present).map(({path, present, trials}) => ({path, count: present, text: `${path} (${present} of ${trials})`})),
      ...laboratories.filter((one) => one.experiment && !one.error && one.recordings.length)
        .map(({path, recordings}) => ({path, count: recordings.length, lab: true, text: `${path} (laboratory)`}))];
  },

  update() {
    const found = this.folders();
    this.none.hidden = found.length > 0;
    this.campaign.closest('.fields').hidden = !found.length;
    fill(this.campaign, found.map(({path, text}) => ({value: path, text})), this.wanted);
    this.wanted = undefined;
    const key = `${this.campaign.value} ${found.find((one) => one.path === this.campaign.value)?.count}`;
    if (found.length && key !== this.listed) { this.listed = key; this.list(); }
  },

  async list() {
    const path = this.campaign.value, turn = this.lists.begin(), {lab} = this.folders().find((one) => one.path === path);
    let names;
    try { names = await turn.ask(`/api/trials?${query({path})}`); } catch (error) { this.view.failed(error); return; }
    const fresh = names.filter((name) => !(this.names ?? names).includes(name));
    const same = this.path === path;
    Object.assign(this, {names, path, lab});
    refill(this.trials, names.map((name) => h('li', {}, h('button', {type: 'button', 'data-trial': name,
      'aria-pressed': String(this.opened === `${path}/${name}`), onclick: () => this.open(name)}, name.replaceAll('__', ' ')))));
    if (same && fresh.length && this.follow.checked) this.open(fresh.at(-1));
  },

  open(name) {
    this.opened = `${this.path}/${name}`;
    for (const button of this.trials.querySelectorAll('button')) button.setAttribute('aria-pressed', String(button.dataset.trial === name));
    this.view.open(this.lab ? {path: this.path, run: name} : {path: this.opened});
  },
};

// ---- compare ------------------------------------------------------------------------------------------------------------

// The model that was written last; the nominal one has no file.
const newestModel = () => [...state.workspace.models].filter((model) => !model.error)
  .sort((a, b) => (state.workspace.stamps[b.path] ?? 0) - (state.workspace.stamps[a.path] ?? 0))[0].path;

// Numbers of a report, as its own script reads them.
function floats(text) {
  return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

// The form of a command on measurements; names of its results follow measurements and model.
function runsForm(command, label, suggest = {}) {
  const measured = () => form.value('runs') ?? stem(form.value('impacts') ?? '');
  const folder = () => `reports/${slug(`${command}_${measured()}_${stem(form.value('model') ?? 'nominal')}`)}`;
  const form = commandForm(command, label, {ready: () => form.value('runs') || form.value('impacts'), // each from those before it
    suggest: {runs: () => form.value('runs') ?? runsChoices()[0]?.value ?? '', ...suggest,
      experiment: () => experimentOf(form.value('runs')), output: suggest.output ?? folder}});
  return Object.assign(form, {folder, chooseSoon(runs) { form.wanted = runs; }, update: ((update) => () => { // runs that show up soon
    update();
    if (form.wanted && runsChoices().some((one) => one.value === form.wanted)) { form.choose('runs', form.wanted); form.wanted = null; }
  })(form.update)});
}

const reading = (path) => h('p', {class: 'note', role: 'status'}, `Reading ${path} …`);
const emptyNote = (text) => h('p', {class: 'note'}, text);

const compare = {
  questions: new Questions(), // of the report
  signals: new Questions(), // of a place in it

  build() {
    this.form = runsForm('compare', 'Compare');
    this.report = h('select', {id: 'compare-report', onchange: () => this.open()});
    this.result = h('div', {id: 'compare-result'});
    this.none = emptyNote('No measurements yet: run a campaign first, or practise on one with a hidden effect.');
    return h('section', {}, h('h2', {}, 'Compare model and measurement'), this.none, this.form.node,
      labelled('report', this.report), this.result);
  },

  update() {
    this.none.hidden = runsChoices().length > 0;
    this.form.update();
    const found = state.workspace.reports.filter((path) => path.endsWith('compare.html') || path.endsWith('report.html'));
    // At first the newest comparison; an analysis (report.html) has no heat maps.
    const age = (path) => state.workspace.stamps[path] ?? 0;
    const newest = this.opened ? undefined : found.filter((path) => path.endsWith('compare.html')).sort((a, b) => age(b) - age(a))[0];
    fill(this.report, plain(found), this.wanted && found.includes(this.wanted) ? this.wanted : newest);
    this.report.parentElement.hidden = !found.length;
    const stamp = state.workspace.stamps[this.report.value];
    if (this.report.value && (this.report.value !== this.opened || stamp !== this.stamp)) this.open();
    if (this.wanted === this.report.value) this.wanted = null;
  },

  async open() {
    const path = this.opened = this.report.value, turn = this.questions.begin();
    this.signals.begin();
    this.stamp = state.workspace.stamps[path];
    this.result.replaceChildren(reading(path));
    if (path.endsWith('report.html')) {
      says('compare', `An analysis of measured jumps: ${path}.`);
      this.result.replaceChildren(...wholeReport(path, true));
      return;
    }
    try {
      const folder = path.replace(/\/?compare\.html$/, '') || '.';
      this.show(await turn.ask(`/api/comparison?${query({path: folder})}`), path, turn);
    } catch (error) { this.result.replaceChildren(h('p', {class: 'error', role: 'alert'}, error.message)); }
  },

  show(found, path, turn) {
    this.signal = h('div', {id: 'signal'});
    this.frame = wholeReport(path, false);
    this.replay = replayOf(path, turn);
    const choose = h('select', {'aria-label': 'place', id: 'cell', onchange: () => this.openSignal(found.cells[choose.value], path)},
      ...found.cells.map((cell, index) => [cell, index]).filter(([cell]) => cell.matters).slice(0, 60).map(([cell, index]) =>
        new Option(`${cell.row}, ${cell.column} ${cell.map ? `(${cell.map})` : ''}: ${cell.error}, ${cell.times} ×`, index)));
    const maps = found.figures.map(({title, figure}) => {
      const node = h('div', {class: 'plot clickable', role: 'img', 'aria-label': `Where the model fails: ${title}`});
      return {title, figure, node};
    });
    this.yardstick = found.yardstick;
    says('compare', `${found.model}: score ${number(found.score)}, where ${number(found.floor)} is noise.`);
    this.result.replaceChildren(h('p', {class: 'answer'}, h('b', {}, `Score ${number(found.score)}`), found.headline),
      maps.length ? h('p', {class: 'note'}, `Measured minus model, in multiples of ${found.yardstick} (blue: measured larger, red: smaller). Click on a cell to see its signal over time.`) : '',
      ...maps.flatMap(({title, node}) => [h('h3', {}, title), node]),
      found.cells.length ? labelled('or choose a place, the worst first', choose) : '', this.signal, this.replay.node, ...this.frame,
      ...found.remarks.map((text) => h('p', {class: 'note'}, `Note: ${text}`)));
    for (const {title, figure, node} of maps) {
      draw(node, figure).then(() => node.on('plotly_click', ({points: [point]}) => {
        const index = found.cells.findIndex((cell) => cell.row === point.y && cell.column === point.x && (!cell.map || cell.map === title));
        if (index < 0) return;
        choose.value = index;
        node.after(this.signal);
        this.openSignal(found.cells[index], path);
      }));
    }
  },

  // Signals over time, from the report's own page, which is read once.
  tracks(path) {
    const key = `${path} ${this.stamp}`;
    if (this.tracksOf !== key) {
      this.tracksOf = key;
      this.tracksRead = pageOf(path).then((page) => {
        const plot = page.getElementById('tracks'), data = page.getElementById('tracks-data');
        return plot && data ? {sets: JSON.parse(data.textContent), figure: JSON.parse(page.getElementById(plot.dataset.tracks).textContent)} : null;
      });
    }
    return this.tracksRead;
  },

  // The signal that shows a cell best, measured and predicted, from the data of the report's own page.
  async openSignal(cell, path) {
    const found = await this.signals.begin().of(this.tracks(path));
    if (!found) { this.signal.replaceChildren(emptyNote('This report has no signals over time.')); return; }
    const {sets, figure} = found;
    const set = sets.find((one) => one.label.startsWith(cell.set)) ?? sets[0];
    const signal = set.signals.find((one) => one.name === cell.signal) ?? set.signals[0];
    const time = floats(set.time), measured = floats(signal.measured), predicted = floats(signal.predicted);
    const rest = measured.map((value, i) => value - predicted[i]);
    const data = [measured, predicted, rest].map((y, index) => ({...figure.data[index], x: time, y}));
    const shown = unit(signal.unit) ? ` [${signal.unit}]` : '';
    const layout = {...figure.layout, height: 420, shapes: figure.layout.shapes.map((shape) => ({...shape, visible: set.impact !== null,
      x0: set.impact, x1: set.impact})), yaxis: {...figure.layout.yaxis, title: {text: `signal${shown}`}},
    yaxis2: {...figure.layout.yaxis2, title: {text: `residual${shown}`}}};
    const plot = h('div', {class: 'plot'});
    this.signal.replaceChildren(h('h3', {}, `${signal.name}, ${set.label}`),
      h('p', {class: 'note'}, `${cell.row} differs by ${cell.error}, ${cell.times} × ${this.yardstick}; this signal shows it best. Dotted: start of the impact.`),
      plot);
    draw(plot, {data, layout});
    this.replay.show(set.label, set.impact);
    this.signal.scrollIntoView({block: 'nearest'});
  },
};

const pageOf = async (path) => new DOMParser().parseFromString(await (await fetch(`/files/${path}`)).text(), 'text/html');

// The runs of a report in 3D: measured, and the model as a ghost. `show` goes to a run and a moment.
function replayOf(path, turn) {
  const choose = h('select', {'aria-label': 'run in 3D'}), place = h('div', {});
  const node = h('div', {class: 'replays', hidden: true}, h('h3', {}, 'In 3D, beside the model'), choose, place);
  const ready = (async () => {
    const data = (await turn.of(pageOf(path))).getElementById('replay-data');
    if (!data) return null;
    node.hidden = false;
    const runs = JSON.parse(data.textContent), made = await replayIn(place, runs);
    choose.replaceChildren(...runs.runs.map((run, number_) => new Option(run.label, number_)));
    choose.hidden = runs.runs.length < 2;
    choose.addEventListener('change', () => made.show(Number(choose.value)));
    return {runs: runs.runs, made};
  })().catch((error) => { place.textContent = error.message; return null; });
  return {node, async show(label, time) {
    const found = await ready, number_ = found?.runs.findIndex((run) => run.label === label) ?? -1;
    if (number_ < 0) return;
    choose.value = number_;
    if (found.made.number !== number_) found.made.show(number_);
    if (time !== null) found.made.seek(time);
  }};
}

// A report of the folder, sandboxed as if from another site, so that its scripts cannot act here.
function wholeReport(path, open) {
  const stamp = state.workspace.stamps[path] ?? '';
  const frame = () => h('iframe', {src: `/files/${path}?${stamp}`, title: `report ${path}`, sandbox: 'allow-scripts allow-popups'});
  const details = h('details', {open}, h('summary', {}, 'The whole report'));
  if (open) details.append(frame());
  details.addEventListener('toggle', () => { if (details.open && !details.querySelector('iframe')) details.append(frame()); });
  return [h('p', {}, h('a', {href: `/files/${path}`, target: '_blank', rel: 'noopener'}, `Open ${path} by itself`)), details];
}

// ---- diagnose -----------------------------------------------------------------------------------------------------------

const diagnose = {
  questions: new Questions(),

  build() {
    this.form = runsForm('diagnose', 'Diagnose', {report: () => this.form.folder(),
      output: () => `${this.form.value('report') ?? this.form.folder()}/diagnosis.json`});
    this.file = h('select', {id: 'diagnose-file', onchange: () => this.open()});
    this.progress = h('div', {});
    this.result = h('div', {id: 'diagnose-result'});
    return h('section', {}, h('h2', {}, 'Find out what the model lacks'), this.form.node, this.progress,
      labelled('diagnosis', this.file), this.result);
  },

  update() {
    this.form.update();
    const files = state.workspace.diagnoses.map(({path, verdict, model}) => ({value: path, text: `${path}: ${model}, ${verdict}`}));
    fill(this.file, files, this.wanted && files.some((one) => one.value === this.wanted) ? this.wanted : undefined);
    this.file.parentElement.hidden = !files.length;
    const stamp = state.workspace.stamps[this.file.value];
    if (this.file.value && (this.file.value !== this.opened || stamp !== this.stamp)) this.open();
    if (this.wanted === this.file.value) this.wanted = null;
  },

  jobs() {
    const job = state.jobs.find((one) => one.arguments[0] === 'diagnose' && one.ended === null);
    const ranking = job?.progress?.ranking ?? [];
    this.progress.replaceChildren(...(job ? [h('p', {role: 'status'}, progressText(job)), progressBar(job),
      ranking.length ? h('p', {class: 'note'}, 'So far: held-out error with each effect, the smaller the better.') : '',
      ranking.length ? h('ol', {class: 'bars'}, ...ranking.map(([name, error]) => h('li', {},
        h('span', {}, name), h('i', {style: `width: ${Math.min(100, 100 * error / ranking[ranking.length - 1][1]).toFixed(1)}%`}),
        h('span', {}, number(error))))) : ''] : []));
  },

  async open() {
    const path = this.opened = this.file.value, turn = this.questions.begin();
    this.stamp = state.workspace.stamps[path];
    this.result.replaceChildren(reading(path));
    try {
      this.show(await turn.ask(`/api/diagnosis?${query({path})}`), turn);
    } catch (error) { this.result.replaceChildren(h('p', {class: 'error', role: 'alert'}, error.message)); }
  },

  show(found, turn) {
    const plot = h('div', {class: 'plot', role: 'img', 'aria-label': 'Held-out error by effect'});
    const rows = found.effects.slice(0, 12).map((effect) => h('tr', {class: effect.tag === 'good' ? 'main' : ''},
      h('td', {title: effect.sentence}, effect.name), h('td', {class: 'text'}, effect.verdict),
      h('td', {}, `${number(effect.without)} → ${number(effect.with)}`), h('td', {}, effect.p),
      h('td', {}, effect.tag === 'no' ? '' : h('button', {type: 'button', onclick: () => add.start(this.opened, effect.name)}, 'Add'))));
    const named = found.effects.filter((effect) => found.named.includes(effect.name));
    const report = this.opened.replace(/[^/]*$/, found.report);
    says('diagnose', `${found.model}: ${found.verdict}.`);
    this.result.replaceChildren(h('p', {class: 'answer', id: 'verdict'}, h('b', {}, found.verdict), found.summary),
      ...named.map((effect) => h('div', {class: 'scroll'}, h('h3', {}, effect.name), h('table', {}, h('thead', {}, h('tr', {},
        ...['parameter', 'estimate', '95 % interval', 'unit'].map((text) => h('th', {scope: 'col'}, text)))), h('tbody', {},
        ...effect.parameters.map((one) => h('tr', {}, h('td', {}, one.name), h('td', {}, one.text[0]),
          h('td', {}, one.text.slice(1).join(' … ') || '–'), h('td', {}, unit(one.unit)))))))),
      h('h3', {}, 'Ranking'), h('p', {class: 'note'}, `Held-out error without and with the effect, ${found.unit}.`), plot, h('div', {class: 'scroll'}, h('table', {id: 'ranking'}, h('thead', {}, h('tr', {},
        ...['effect', 'verdict', 'without → with', 'p', 'add to the model'].map((text) => h('th', {scope: 'col', class: text === 'verdict' ? 'text' : null}, text)))), h('tbody', {}, ...rows))),
      found.left.length ? h('div', {}, h('h3', {}, 'Unexplained'), h('ul', {}, ...found.left.map((one) => h('li', {},
        `${one.what} (${one.phase}): ${one.value}, ${one.times} × ${found.yardstick}; relevance limit ${one.floor}`)))) : '',
      found.calls_for_a_law ? this.law(found) : '',
      found.practice ? this.revealed() : '',
      found.calibrate.length ? h('div', {class: 'answer', id: 'calibrate'}, h('b', {}, 'Calibrate the readings'),
        ...found.calibrate.map((one) => h('p', {}, h('code', {}, one.effect), `: ${one.experiment}.`))) : '',
      found.next ? this.next(found.next, found.runs) : '',
      ...(state.workspace.reports.includes(report) ? [replayOf(report, turn).node, ...wholeReport(report, false)] :
        [emptyNote('There is no report beside this file: a diagnosis with a folder of the report writes one.')]),
      ...found.remarks.map((text) => h('p', {class: 'note'}, `Note: ${text}`)));
    if (found.figure) draw(plot, found.figure); else plot.remove();
  },

  // What no effect explains may be a law of the same measurements: discover gets the options of the opened diagnosis.
  law(found) {
    const place = this.opened.replace(/[^/]*$/, ''), known = found.law.runs || found.law.impacts;
    const model = state.workspace.models.find((one) => one.digest === found.digest)?.path ?? found.law.model;
    return h('div', {class: 'answer', id: 'law'}, h('b', {}, 'A law that the library does not have'),
      h('p', {}, 'Formulas of a grammar may explain what remains; where none holds, a curve describes it.'),
      known ? h('div', {class: 'actions'}, ...jobButton('Look for a law', () => ({command: 'discover', ...found.law, model,
        report: place.slice(0, -1) || '.', output: `${place}discovery.json`}), {class: 'primary'})) :
        h('p', {class: 'note'}, 'The measurements of this diagnosis are not in this folder, or an earlier version wrote it: ',
          'diagnose them here, or use impact-rs discover in a terminal.'));
  },

  revealed() {
    const answer = h('div', {id: 'revealed'}), path = this.opened;
    return h('div', {}, h('div', {class: 'actions'}, h('button', {type: 'button', id: 'reveal', onclick: () => reveal(path, answer)},
      'Reveal what was hidden'), h('span', {class: 'note'}, 'of a practice campaign')), answer);
  },

  next(experiment, runs) {
    const run = experiment.scenario ? jobButton('Run it', () => ({command: 'campaign', scenario: experiment.scenario,
      output: `${nextFolder(runs)}/next_${slug(experiment.scenario)}_${slug(experiment.object ?? '')}`,
      objects: experiment.object ? [experiment.object] : null, cases: experiment.case ? [experiment.case] : null, scales: [1], trials: 3}),
    {class: 'primary'}) : [];
    return h('div', {class: 'answer'}, h('b', {}, 'Next experiment'), h('p', {}, experiment.advice), h('div', {class: 'actions'}, ...run,
      h('button', {type: 'button', id: 'design-next', onclick: () => design.after(this.opened, runs)}, 'Design more trials')));
  },
};

// What a practice campaign hid, beside what its diagnosis found. `path`: the campaign, or the diagnosis.
async function reveal(path, node) {
  node.replaceChildren(reading(path));
  try {
    const found = await ask(`/api/reveal?${query({path})}`);
    const list = (names) => names.join(' + ') || 'nothing';
    node.replaceChildren(h('div', {class: 'answer', 'data-correct': String(found.correct)},
      h('b', {class: found.correct ? 'good' : 'error'}, found.correct ? '✓ right' : '✗ wrong'),
      `Hidden: ${list(found.truth)}. Named: ${list(found.named)}.`,
      found.parameters.length ? h('div', {class: 'scroll'}, h('table', {}, h('thead', {}, h('tr', {}, ...['parameter', 'hidden', 'estimate', '95 % interval', 'inside'].map((text) =>
        h('th', {scope: 'col'}, text)))), h('tbody', {}, ...found.parameters.map((one) => h('tr', {}, h('td', {}, `${one.name}${unit(one.unit) ? ` [${one.unit}]` : ''}`),
        h('td', {}, number(one.hidden)), h('td', {}, number(one.estimate)), h('td', {}, one.low === null ? '–' : `${number(one.low)} … ${number(one.high)}`),
        h('td', {}, one.low === null ? '–' : one.low <= one.hidden && one.hidden <= one.high ? '✓' : '✗')))))) : ''),
    commandLine(found.command));
  } catch (error) { node.replaceChildren(h('p', {class: 'error', role: 'alert'}, inFolder(error.message))); }
}

// Further trials are written beside the measured ones, so that the same RUNS contains them.
const nextFolder = (runs) => state.workspace.campaigns.some((one) => one.path === runs && one.scenario) ?
  runs.split('/').slice(0, -1).join('/') || 'campaigns' : runs || 'campaigns';

// ---- add ----------------------------------------------------------------------------------------------------------------

const EXAMPLE = `effects:
- name: cable_drag
  sentence: A cable drags behind the end effector.
  end_effector_force: {y: "-drag * vy"}
  parameters:
    drag: {unit: N s/m, nominal: 0, lower: 0, upper: 50, scale: 1}
`;

const add = {
  questions: new Questions(), // of the diagnosis
  texts: new Questions(), // of the formula

  build() {
    const form = this.form = commandForm('add', 'Add the effects', {offers: ['effect'], first: 'source', ready: () => this.parent && form.value('effect')?.length,
      suggest: {model: () => this.parent ?? 'nominal', output: () => this.next()}});
    form.control('source').addEventListener('change', () => this.choose());
    this.note = h('p', {class: 'note'});
    this.text = h('textarea', {id: 'formula', spellcheck: 'false', 'aria-label': 'effect as a formula, in YAML', oninput: () => this.check()});
    this.text.value = EXAMPLE;
    this.checked = h('div', {id: 'formula-check', 'aria-live': 'polite'});
    this.name = h('input', {value: 'formulas/mine.yaml', id: 'formula-file'});
    return h('section', {}, h('h2', {}, 'A better model'), h('h3', {}, 'Add diagnosed effects'), this.note, this.form.node,
      h('h3', {}, 'Your own effect'), h('p', {class: 'note'}, 'A formula, checked while you write. Save it to use it in Diagnose.'),
      this.text, this.checked, h('div', {class: 'fields'}, labelled('file', this.name)),
      h('div', {class: 'actions'}, this.save = h('button', {type: 'button', onclick: () => this.keep()}, 'Save the formulas')));
  },

  update() {
    this.form.update();
    if (this.wanted) this.form.choose('source', this.wanted.file);
    const file = this.form.value('source');
    if (!file) this.note.textContent = 'No diagnosis yet.';
    if (file !== this.opened || this.wanted || state.workspace.stamps[file] !== this.stamp) this.choose();
    if (!this.wasChecked) { this.wasChecked = true; this.check(); }
  },

  async choose() {
    const path = this.opened = this.form.value('source'), turn = this.questions.begin();
    if (!path) return;
    this.stamp = state.workspace.stamps[path];
    this.parent = null; // of the earlier diagnosis
    this.form.offer('effect', []);
    this.note.textContent = `Reading ${path} …`;
    this.form.refresh();
    try {
      const found = await turn.ask(`/api/diagnosis?${query({path})}`);
      this.parent = state.workspace.models.find((model) => model.digest === found.digest)?.path ?? null;
      this.note.textContent = this.parent ? `Diagnosis of ${found.model}: ${found.summary}` : `The diagnosed model ${found.model} is not in this folder.`;
      const order = [...found.effects].sort((a, b) => found.named.includes(b.name) - found.named.includes(a.name));
      const wanted = this.wanted?.effect ? [this.wanted.effect] : found.named.length ? found.named : order.slice(0, 1).map((one) => one.name);
      this.form.offer('effect', order.map((one) => ({value: one.name, text: `${one.name}: ${one.verdict}${one.of_measurement ? ' (of the measurement: into the calibration)' : ''}`,
        on: wanted.includes(one.name)})));
      this.wanted = null;
      this.form.refresh();
    } catch (error) { this.note.textContent = error.message; }
  },

  // A file that is none yet; the first model is the nominal one.
  next() { return free((count) => `models/model_${count + 1}.yaml`, (state.workspace?.models ?? []).map((model) => model.path)); },

  start(file, effect) { this.wanted = {file, effect}; go('add'); },

  async check() {
    const turn = this.texts.begin();
    await turn.pause(150);
    try {
      const {effects} = await turn.ask('/api/formulas/check', {text: this.text.value});
      this.checked.replaceChildren(...effects.map((effect) => h('div', {}, h('p', {class: 'good'}, `✓ ${effect.name}: ${effect.sentence}`),
        h('ul', {}, ...effect.lines.map((line) => h('li', {}, line))))));
      this.save.disabled = false;
    } catch (error) {
      this.checked.replaceChildren(h('p', {class: 'error', role: 'alert'}, error.message));
      this.save.disabled = true;
    }
  },

  async keep() {
    try {
      const {command} = await this.texts.begin().of(ask('/api/formulas', {path: this.name.value, text: this.text.value}));
      this.checked.replaceChildren(h('p', {class: 'good'}, `Saved as ${this.name.value}.`), commandLine(command));
    } catch (error) { this.checked.replaceChildren(h('p', {class: 'error', role: 'alert'}, error.message)); }
  },
};

// ---- history --------------------------------------------------------------------------------------------------------------

const history_ = {
  build() {
    this.form = runsForm('history', 'Show the history', {model: newestModel});
    this.result = h('div', {id: 'history-result'});
    return h('div', {}, this.form.node, this.result);
  },

  update() {
    this.form.update();
    const found = state.workspace.reports.filter((path) => path.endsWith('history.html'));
    const newest = found.sort((a, b) => state.workspace.stamps[b] - state.workspace.stamps[a])[0];
    const key = newest && `${newest} ${state.workspace.stamps[newest]}`;
    if (newest && this.opened !== key) {
      this.opened = key;
      this.result.replaceChildren(...wholeReport(newest, true));
    }
  },
};

// ---- investigate ----------------------------------------------------------------------------------------------------------

const investigate = {
  questions: new Questions(),

  build() {
    this.form = commandForm('investigate', 'Investigate', {first: 'budget',
      suggest: {directory: () => free((count) => `investigations/${count}`, state.workspace ? this.folders() : [])}});
    this.file = h('select', {id: 'investigate-file', onchange: () => this.open()});
    this.result = h('div', {id: 'investigate-result'});
    return h('div', {}, this.form.node, labelled('investigation', this.file), this.result);
  },

  // Folders of investigations, by their pages.
  folders() { return state.workspace.reports.filter((path) => path.endsWith(PAGE)).map((path) => path.slice(0, -PAGE.length)); },

  update() {
    this.form.update();
    const found = this.folders();
    fill(this.file, plain(found), this.wanted && found.includes(this.wanted) ? this.wanted : undefined);
    this.file.parentElement.hidden = !found.length;
    const stamp = state.workspace.stamps[`${this.file.value}${PAGE}`];
    if (this.file.value && (this.file.value !== this.opened || stamp !== this.stamp)) this.open();
    if (this.wanted === this.file.value) this.wanted = null;
  },

  async open() {
    const path = this.opened = this.file.value, turn = this.questions.begin();
    this.stamp = state.workspace.stamps[`${path}${PAGE}`];
    this.result.replaceChildren(reading(path));
    try {
      const {ending, rounds, trials} = await turn.ask(`/api/investigation?${query({path})}`);
      const so_far = `${trials} trial${trials === 1 ? '' : 's'} in ${rounds} round${rounds === 1 ? '' : 's'}`;
      says('investigate/loop', `${path}: ${ending ? ending.verdict : 'not at its end'}, after ${so_far}.`);
      this.result.replaceChildren(h('p', {class: 'answer', id: 'ending'}, h('b', {}, ending ? ending.verdict : 'goes on'), ending ? ending.summary : `${so_far} so far.`),
        ...wholeReport(`${path}${PAGE}`, true));
    } catch (error) { this.result.replaceChildren(mistake(error)); }
  },
};

const PAGE = '/report/investigation.html';

// ---- evidence ---------------------------------------------------------------------------------------------------------------

const evidence = {
  build() {
    const pack = this.pack = commandForm('evidence pack', 'Pack the evidence', {ready: () => ['diagnosis', 'data'].every((name) => pack.value(name)),
      suggest: {diagnosis: () => state.workspace?.diagnoses[0]?.path, model: () => this.model(), data: () => runsChoices()[0]?.value,
        output: () => free((count) => `evidence/${slug(pack.value('laboratory') ?? 'laboratory')}${count > 1 ? `_${count}` : ''}.json`, state.workspace?.packages ?? [])}});
    const check = this.check = commandForm('evidence check', 'Check the package', {ready: () => check.value('package')});
    const merge = this.merge = commandForm('evidence merge', 'Merge the packages', {ready: () => merge.value('packages').length,
      suggest: {output: () => 'evidence/merged.json'}});
    this.printed = Object.fromEntries(['pack', 'check', 'merge'].map((name) => [name, new Printed(`evidence ${name}`)]));
    return h('div', {}, ...Object.entries({pack: 'Pack a diagnosis', check: 'Check a package', merge: 'What several packages say'})
      .flatMap(([name, title]) => [h('h3', {}, title), this[name].node, this.printed[name].node]));
  },

  // The model of the chosen diagnosis.
  model() {
    const digest = state.workspace?.diagnoses.find((one) => one.path === this.pack.value('diagnosis'))?.digest;
    return state.workspace?.models.find((one) => one.digest === digest)?.path ?? 'nominal';
  },

  update() {
    for (const name of ['pack', 'check', 'merge']) { this[name].update(); this.printed[name].jobs(); }
    const {packages} = state.workspace;
    says('history/evidence', packages.length ? `${packages.length} package${packages.length === 1 ? '' : 's'}: ${packages.join(', ')}.` : '');
  },
};

// ---- following ----------------------------------------------------------------------------------------------------------------

const follow = {
  build() {
    const form = this.form = commandForm('follow', 'Follow', {offers: ['runs'], ready: () => form.value('runs') || form.value('impacts'),
      suggest: {model: newestModel, state: () => `followed/${slug(form.value('runs') ?? stem(form.value('impacts') ?? 'hits'))}.npz`,
        output: () => free((count) => `models/followed_${count}.yaml`, (state.workspace?.models ?? []).map((one) => one.path))}});
    this.printed = new Printed('follow', (job) => says('investigate/follow', job.ended === null ? `Job ${job.number} follows ${job.arguments[1]}.` :
      `Job ${job.number} has followed ${inFolder(job.arguments[1])}.`));
    return h('div', {}, form.node, this.printed.node);
  },

  update() {
    const runs = plain(state.workspace.runs);
    this.form.offer('runs', runs, this.form.value('runs') ?? (this.form.value('impacts') ? '' : runs[0]?.value));
    this.form.update();
    this.printed.jobs();
  },
};

// Measurements of a form are the rows of a table of impacts.
function takeTable(form, table, scenario) {
  form.choose('runs', '');
  form.choose('impacts', table);
  if (scenario) form.choose('scenario', scenario);
}

// ---- laboratory -----------------------------------------------------------------------------------------------------------

// Recordings described by what their numbers say.
const importing = {
  build() {
    const form = this.form = commandForm('import', 'Look at the files', {ready: () => form.value('files').length, suggest: {
      output: () => form.value('files')[0] ?? ''}}); // beside the recordings, where the other steps find it
    this.none = emptyNote('Copy a folder of recordings (bags, CSV, Parquet, NPZ, NPY, MAT or HDF5) into this folder: it appears here.');
    this.printed = new Printed('import', (job) => says('laboratory/import', job.exit_code === 0 ? `Job ${job.number} has described ${inFolder(job.writes[0])}.` : ''));
    return h('div', {}, this.none, form.node, this.printed.node);
  },

  update() {
    this.none.hidden = state.workspace.laboratories.length > 0;
    this.form.update();
    this.printed.jobs();
  },
};

const impacts = {
  build() {
    const form = this.form = commandForm('impacts', 'Find the impacts', {offers: ['directory'], first: 'directory', ready: () => form.value('directory'),
      suggest: {experiment: () => experimentOf(form.value('directory')), output: () => free((count) =>
        `impacts/${slug(form.value('directory') ?? 'lab')}${count > 1 ? `_${count}` : ''}.csv`, state.workspace?.tables ?? [])}});
    this.none = emptyNote('Describe a folder of recordings first, here or with Import.');
    this.printed = new Printed('impacts');
    this.tables = h('div', {id: 'impact-tables'});
    return h('div', {}, this.none, form.node, this.printed.node, this.tables);
  },

  update() {
    const labs = state.workspace.laboratories.filter((lab) => lab.experiment && !lab.error), {tables} = state.workspace;
    this.none.hidden = labs.length > 0;
    this.form.offer('directory', plain(labs.map((lab) => lab.path)));
    this.form.update();
    this.printed.jobs();
    says('laboratory/impacts', tables.length ? `${tables.length} table${tables.length === 1 ? '' : 's'}: ${tables.join(', ')}.` : '');
    const use = (text, step, tab, form, table) => h('button', {type: 'button', onclick: () => { go(step, tab); takeTable(form, table, this.scenarioOf(table)); }}, text);
    refill(this.tables, [...(tables.length ? [h('h3', {}, 'Tables of impacts')] : []), ...tables.map((table) => h('div', {class: 'actions', 'data-table': table},
      h('code', {}, table), use('Compare', 'compare', '', compare.form, table), use('Diagnose', 'diagnose', '', diagnose.form, table),
      use('Follow', 'investigate', 'follow', follow.form, table)))]);
  },

  // The scenario of the recordings in which a job has found the impacts of a table.
  scenarioOf(table) {
    const job = state.jobs.find((one) => one.arguments[0] === 'impacts' && one.writes.some((path) => inFolder(path) === table));
    const experiment = job && job.arguments[job.arguments.indexOf('--experiment') + 1];
    return state.workspace.laboratories.find((lab) => lab.experiment && experiment?.endsWith(lab.experiment))?.scenario;
  },
};

const ARM_SIGNALS = [{name: 'position', text: 'joint position'}, {name: 'velocity', text: 'joint velocity'},
  {name: 'torque', text: 'joint torque'}, {name: 'command', text: 'commanded torque', optional: true}];
const OBJECT_POSE = {name: 'object_pose', text: 'pose of the object', optional: true};

// Where stamps and rows are in the files of an arm, as far as import has found it.
const layoutOf = ({given: {time, table}}) => ({...(time && {time}), ...(table && {table})});

const laboratory = {
  questions: new Questions(),

  build() {
    this.folder = h('select', {id: 'lab-folder', onchange: () => this.look()});
    this.scenario = h('select', {id: 'lab-scenario', onchange: () => this.look()});
    this.none = emptyNote('No recordings in this folder yet: copy a folder with one bag, CSV, Parquet, NPZ or HDF5 file per run into it, ' +
      'and it appears here.');
    this.message = messageArea();
    this.body = h('div', {id: 'lab'});
    return h('div', {}, this.none, h('div', {class: 'fields'}, labelled('folder of recordings', this.folder),
      labelled('scenario: robots, boxes', this.scenario)), this.body, this.message.node);
  },

  update() {
    const found = state.workspace.laboratories;
    this.none.hidden = found.length > 0;
    this.folder.closest('.fields').hidden = !found.length;
    const first = found.find((lab) => !lab.experiment)?.path;
    fill(this.folder, found.map((lab) => ({value: lab.path, text: `${lab.path}${lab.experiment ? ' (described)' : ''}`})),
      this.wanted ?? (this.folder.value || first));
    this.wanted = null;
    fill(this.scenario, plain(state.workspace.scenarios), this.scenario.value || 'push');
    if (this.folder.value && this.folder.value !== this.looked) this.look();
    else if (this.offered && this.offered === this.looked && !this.found.table) this.addRows(found.find((lab) => lab.path === this.looked));
  },

  // Recordings that have come since; what is filled in stays.
  addRows(lab) {
    const there = new Set([...this.rows.children].map((row) => row.dataset.recording));
    for (const name of lab?.recordings ?? []) if (!there.has(name)) this.rows.append(this.row(name, this.objects));
  },

  async look() {
    const folder = this.looked = this.folder.value, turn = this.turn = this.questions.begin();
    says('laboratory/laboratory', `${folder} is shown.`);
    this.offered = null;
    this.lab = state.workspace.laboratories.find((lab) => lab.path === folder);
    this.message.show();
    this.body.replaceChildren(reading(folder));
    if (this.lab.error) this.message.error(this.lab.error);
    try {
      const name = this.scenario.value;
      const [found, {objects}] = await Promise.all([turn.ask(`/api/laboratory?${query({path: folder, scenario: name})}`),
        turn.ask(`/api/scenario?${query({name})}`)]);
      const lab = state.workspace.laboratories.find((one) => one.path === folder) ?? this.lab; // recordings may have come meanwhile
      Object.assign(this, {lab, found, objects, offered: folder});
      this.arms = Object.entries(found.arms).map(([arm, given]) => this.arm(arm, given));
      this.pose = this.signal(OBJECT_POSE, this.arms[0], found.object_pose);
      this.world = h('input', {type: 'checkbox', id: 'lab-world'});
      this.rows = h('tbody', {}, ...(found.table ? found.table.rows.map((one) => h('tr', {}, ...[one.bag, one.object, one.kind, one.condition]
        .map((text) => h('td', {class: 'text'}, text)))) : this.lab.recordings.map((recording) => this.row(recording, objects))));
      const table = found.table && (found.table.error ? h('p', {class: 'error'}, found.table.error) :
        h('p', {class: 'note', id: 'lab-table'}, `From ${found.table.name} of the folder; change it in an editor.`));
      this.body.replaceChildren(
        h('h3', {}, `Signals of ${found.recording}`), h('p', {class: 'note'}, 'Choose the source and the unit of each signal, and check its plot: are the numbers right?'),
        h('div', {class: this.arms.length > 1 ? 'arms' : ''}, ...this.arms.map((one) => one.node)),
        this.pose.node,
        h('label', {class: 'tick'}, this.world, ' the world frame of the tracker is not that of the robot: estimate it from the contact in the hits'),
        h('h3', {}, 'Runs'), table, h('div', {class: 'scroll'}, h('table', {}, h('thead', {}, h('tr', {}, ...['recording', 'object', 'kind', 'condition']
          .map((text) => h('th', {scope: 'col', class: 'text'}, text)))), this.rows)),
        h('div', {class: 'actions'}, h('button', {type: 'button', class: 'primary', id: 'lab-save', onclick: () => this.keep()},
          'Write experiment.yaml and mapping')));
      for (const one of [...this.arms.flatMap((arm) => arm.signals), this.pose]) one.show();
    } catch (error) {
      this.message.error(error.message);
      this.body.replaceChildren();
    }
  },

  // Joints, signals and gravity of one arm; a heading where there are several.
  arm(name, given) {
    const several = Object.keys(this.found.arms).length > 1;
    const own = {name, given, several, label: several ? ` of ${name}` : ''};
    const named = this.found.streams.some((stream) => stream.joints.length);
    own.names = h('textarea', {class: 'names', rows: several ? 3 : 2, onchange: () => { for (const one of own.signals) one.show(); }}, given.joints.join(', '));
    own.joints = () => own.names.value.split(/[\s,]+/).filter(Boolean);
    own.gravity = h('input', {type: 'checkbox', checked: true, onchange: () => own.signals.at(-1).show()});
    own.signals = ARM_SIGNALS.map((signal) => this.signal(signal, own, given.signals[signal.name]));
    own.node = h('section', {'data-lab-arm': name}, several ? h('h3', {}, `Arm ${name}, ${given.robot}`) : '',
      given.said.length ? h('details', {'data-lab-said': name}, h('summary', {}, 'what shows it'), ...given.said.map((one) => h('p', {class: 'note'}, one))) : '',
      named ? labelled(`joints in order, base to tip (${given.slides.length} of ${given.robot})`, own.names) : '', ...own.signals.map((one) => one.node),
      h('label', {class: 'tick'}, own.gravity, ' the commanded torque includes gravity compensation'));
    return own;
  },

  signal(signal, arm, proposed) {
    const pose = signal.name === 'object_pose', streams = this.found.streams;
    const what = pose ? signal.text : `${signal.text}${arm.label}`;
    const source = h('select', {'data-signal': signal.name}, ...(signal.optional ? [new Option('not recorded', '')] : []),
      ...streams.flatMap((stream, number_) => stream.pose === pose ? [new Option(stream.label, number_)] : []));
    source.value = proposed ?? (signal.optional ? '' : source.options[0]?.value ?? '');
    const shown = arm.given.units[signal.name];
    const slides = pose ? [] : arm.given.slides, [turning, sliding] = this.found.units[signal.name];
    const kinds = [[turning, slides.every((one) => one) && !pose ? '' : 'turn'], [sliding, slides.some((one) => one) ? 'slide' : '']].filter(([, how]) => how);
    const units = kinds.map(([all, how]) => ({how, select: h('select', {}, ...all.map((one) => new Option(one, one)))}));
    for (const {select} of units) for (const unit of [shown].flat()) if ([...select.options].some((one) => one.value === unit)) select.value = unit;
    const plot = h('div', {class: 'plot', role: 'img', 'aria-label': `preview of ${what}`});
    const line = h('p', {class: 'note', 'aria-live': 'polite'});
    const unitOf = (how) => (units.find((one) => one.how === how) ?? units[0]).select.value;
    const value = () => source.value === '' ? null : {...streams[source.value].source,
      unit: units.length > 1 ? slides.map((one) => unitOf(one ? 'slide' : 'turn')) : units[0].select.value};
    const questions = new Questions();
    const clear = (text, kind) => { line.className = kind; line.textContent = text; erase(plot); };
    const show = async () => {
      const turn = questions.begin();
      if (source.value === '') { clear('', 'note'); return; }
      try {
        const seen_ = await turn.ask('/api/laboratory/preview', {path: this.found.path, scenario: this.scenario.value, arm: arm.name, signal: signal.name,
          source: value(), position: arm.signals?.[0].value() ?? value(), joints: arm.joints(), command_includes_gravity: arm.gravity.checked, ...layoutOf(arm)});
        const ranges = seen_.ranges.map((one) => `from ${number(one.low)} to ${number(one.high)} ${one.unit}`).join(', ');
        line.className = seen_.wrong ? 'error' : 'note';
        line.textContent = seen_.wrong || `${seen_.place}; ${seen_.samples} samples at ${number(seen_.rate)} Hz; ${ranges}`;
        const second = seen_.ranges.length > 1 ? sliding[0] : null; // the SI unit of joints that slide beside others that turn
        await draw(plot, {data: seen_.columns.map((column) => ({x: seen_.time, y: column.values, name: column.name, mode: 'lines', line: {width: 1.2},
          hovertemplate: `%{y:.4g} ${column.unit}`, ...(column.unit === second ? {yaxis: 'y2'} : {})})),
        layout: {height: 170, margin: {l: 50, r: second ? 50 : 10, t: 6, b: 34}, showlegend: false, xaxis: {title: {text: 'time [s]'}},
          yaxis: {title: {text: seen_.ranges.find((one) => one.unit !== second).unit}},
          ...(second ? {yaxis2: {title: {text: second}, overlaying: 'y', side: 'right', tickmode: 'auto', showgrid: false}} : {})}});
      } catch (error) { clear(error.message, 'error'); }
    };
    // All signals of an arm have the clock of its joint positions.
    const changed = () => { if (signal.name === 'position') for (const one of arm.signals) one.show(); else show(); };
    for (const control of [source, ...units.map((one) => one.select)]) control.addEventListener('change', changed);
    const node = h('div', {'data-lab-signal': signal.name}, h('div', {class: `fields ${units.length > 1 ? 'mixed' : ''}`}, labelled(what, source),
      ...units.map((one) => labelled(units.length > 1 ? `unit, joints that ${one.how}` : 'unit', one.select))), line, plot);
    return {node, name: signal.name, value, show};
  },

  // One row of the table of runs; object and kind are guessed from the name of the recording.
  row(recording, objects) {
    const object = h('select', {'aria-label': `object of ${recording}`}, ...Object.entries(objects).map(([value, one]) => new Option(one.label, value)));
    const kind = h('select', {'aria-label': `kind of ${recording}`}, new Option('hit', 'hit'), new Option('free motion', 'free motion'), new Option('leave out', ''));
    const condition = h('input', {'aria-label': `condition of ${recording}`, value: 'case_1'});
    object.value = Object.keys(objects).find((one) => recording.includes(one)) ?? object.options[0].value;
    if (/free|excite/i.test(recording)) kind.value = 'free motion';
    const enable = () => { object.disabled = kind.value !== 'hit'; };
    kind.addEventListener('change', enable);
    enable();
    return h('tr', {'data-recording': recording}, h('td', {}, recording), h('td', {}, object), h('td', {}, kind), h('td', {}, condition));
  },

  async keep() {
    const runs = this.found.table ? null : [...this.rows.children].map((row) => {
      const [object, kind] = row.querySelectorAll('select');
      return {bag: row.dataset.recording, object: kind.value === 'hit' ? object.value : 'none', kind: kind.value, condition: row.querySelector('input').value};
    }).filter((run) => run.kind);
    const chosen = (arm) => Object.fromEntries(arm.signals.map((one) => [one.name, one.value()]).filter(([, value]) => value));
    const folder = this.folder.value;
    try {
      const done = await this.turn.of(ask('/api/laboratory', {path: folder, scenario: this.scenario.value, object_pose: this.pose.value(),
        world_from_hits: this.world.checked, runs, arms: Object.fromEntries(this.arms.map((arm) => [arm.name,
          {joints: arm.joints(), command_includes_gravity: arm.gravity.checked, signals: chosen(arm), ...layoutOf(arm)}]))}));
      this.message.show(h('p', {class: 'good', id: 'lab-written'}, `Written: ${done.written.join(', ')}.`),
        ...done.remarks.map((remark) => h('p', {class: 'note'}, `Note: ${remark}`)), h('p', {}, 'Next:'), commandLine(done.command),
        h('div', {class: 'actions'}, h('button', {type: 'button', onclick: () => { compare.form.chooseSoon(folder); go('compare'); }}, 'Compare')));
    } catch (error) { this.message.error(error.message); }
    this.message.node.scrollIntoView({block: 'nearest'});
  },
};

// ---- the folder, on the left ----------------------------------------------------------------------------------------------

function entry(key, text, small, chosen) {
  return h('li', {}, h('button', {type: 'button', 'data-entry': key, 'aria-pressed': String(state.chosen === key),
    onclick: () => { state.chosen = key; showFolder(); chosen(); }}, text, ...small.map((line) => h('small', {}, line))));
}

function scoreText(score) {
  const held = score.held_out === null || score.held_out === undefined ? '' : `, held out ${number(score.held_out)}`;
  return `error ${number(score.fit)}${unit(score.unit.startsWith('times ') ? '' : score.unit)}${held}` +
    (score.floor ? ` (noise ${number(score.floor)})` : '');
}

const newest = (kind, path) => state.workspace[kind].find((one) => one.path === path);

function showFolder() {
  const {campaigns, laboratories, models, diagnoses, blinds} = state.workspace;
  const count = (number_, what) => `${number_} ${what}${number_ === 1 ? '' : 's'}`;
  const trials = campaigns.reduce((sum, one) => sum + one.present, 0), held = models.filter((one) => one.score);
  for (const tab of ['campaign', 'recorded']) says(`measure/${tab}`, campaigns.length ? `${count(trials, 'trial')} in ${count(campaigns.length, 'campaign')}.` : '');
  says('measure/blind', blinds.length ? `${count(blinds.length, 'practice campaign')}.` : '');
  says('add', models.length > 1 ? `${count(models.length, 'model')}; the newest is ${models.find((one) => one.path === newestModel()).name}.` : '');
  says('overlay/runs', trials ? `${count(trials, 'trial')} to choose from.` : '');
  const compared = state.workspace.reports.filter((path) => path.endsWith('compare.html')).length;
  says('overlay/models', compared ? `${count(compared, 'comparison')} to choose from.` : '');
  says('overlay/estimates', diagnoses.length ? `${count(diagnoses.length, 'diagnosis').replace('diagnosiss', 'diagnoses')} to choose from.` : '');
  says('history/versions', held.length ? `${held.map((one) => `${one.name} ${number(one.score.held_out ?? one.score.fit)}`).join(', ')} ` +
    `(noise ${number(held[0].score.floor)}).` : '');
  const or = (items, text) => items.length ? items : [h('li', {class: 'quiet'}, text)];
  $('root').textContent = state.workspace.root.split('/').pop();
  $('root').title = state.workspace.root;
  const focused = document.activeElement?.dataset?.entry;
  refill($('campaigns'), or(campaigns.map((one) => entry(`campaign ${one.path}`, one.path,
    [one.error || `${one.scenario ? `${one.scenario}, ` : ''}${one.present} of ${one.trials} trials`],
    () => chooseCampaign(newest('campaigns', one.path)))), 'none yet'));
  refill($('laboratories'), or(laboratories.map((one) => entry(`lab ${one.path}`, one.path === '.' ? 'this folder' : one.path,
    [one.error || (one.experiment ? 'described' : `${one.recordings.length} recording${one.recordings.length === 1 ? '' : 's'}, not described`)],
    () => chooseLaboratory(one.path))), 'none yet'));
  const branch = (parent) => models.filter((one) => one.parent === parent && one.path !== parent).map((one) => {
    const children = branch(one.path);
    const item = entry(`model ${one.path}`, one.name, [one.error || one.effects.join(' + ') || 'nothing added',
      ...(one.score ? [`${scoreText(one.score)}, in ${one.score.report}`] : [])], () => chooseModel(newest('models', one.path)));
    if (children.length) item.append(h('ul', {class: 'tree'}, ...children));
    return item;
  });
  refill($('models'), branch(null));
  refill($('diagnoses'), or(diagnoses.map((one) => entry(`diagnosis ${one.path}`, one.path, [`${one.model}: ${one.verdict}`],
    () => { diagnose.wanted = one.path; go('diagnose'); })), 'none yet'));
  if (focused) document.querySelector(`[data-entry="${CSS.escape(focused)}"]`)?.focus();
}

function chooseCampaign(one) {
  if (one.present && !one.error) {
    recorded.wanted = one.path;
    go('measure', 'recorded');
  }
  const use = (step, form) => h('button', {type: 'button', onclick: () => { go(step); form.choose('runs', one.path); }}, step === 'compare' ? 'Compare' : 'Diagnose');
  showAbout({...ABOUT.measure, title: one.path, facts: [one.error || `${one.present} of ${one.trials} trials are recorded.`,
    one.present < one.trials ? 'Run the same command again to continue.' : ''].filter(Boolean),
  actions: [use('compare', compare.form), use('diagnose', diagnose.form),
    ...jobButton('Analyze', () => ({command: 'analyze', directory: one.path}))]});
}

function chooseLaboratory(path) {
  go('laboratory', 'laboratory');
  laboratory.wanted = path;
  laboratory.update();
  const lab = newest('laboratories', path);
  if (!lab.experiment || lab.error) return;
  const then = (text, act) => h('button', {type: 'button', onclick: act}, text);
  showAbout({...ABOUT.laboratory, title: path, facts: [`${lab.recordings.length} recordings, described in ${lab.experiment}.`], actions: [
    then('Show the runs', () => { recorded.wanted = path; go('measure', 'recorded'); }),
    then('Find the impacts', () => { go('laboratory', 'impacts'); impacts.form.choose('directory', path); }),
    then('Compare', () => { go('compare'); compare.form.choose('runs', path); })]});
}

function chooseModel(one) {
  if (!one.error) {
    for (const part of [compare, diagnose, history_]) part.form.choose('model', one.path);
    predict.model.value = one.path;
    if (state.step === 'predict') predict.update();
  }
  showAbout({title: one.name, text: one.note || 'Scenario and the effects added to it.', page: 'effects.md',
    facts: [one.error, one.effects.length ? `Effects: ${one.effects.join(', ')}.` : 'No effects: nominal values only.',
      ...one.scores.map((score) => `${score.report}: ${scoreText(score)}`)].filter(Boolean)});
}

// ---- jobs -----------------------------------------------------------------------------------------------------------------

function progressText(job) {
  const {what = job.arguments[0], done = 0, total = null, left = null, share = null} = job.progress ?? {};
  return [job.stopping ? 'stopping' : job.question ? 'asks' : what, total ? `${done} of ${total}` : '', share === null ? '' : `${Math.round(100 * share)} % of the job`,
    seconds(left)].filter(Boolean).join(', ');
}

function stateText(job) {
  if (job.ended === null) return progressText(job);
  if (job.exit_code === 0) return `✓ done in ${Math.max(1, Math.round(job.ended - job.started))} s`;
  return inFolder(`${job.exit_code === 130 ? '■ stopped' : '✗ failed'}: ${job.line}`);
}

const opened = new Map(); // of jobs whose output is looked at, by their numbers

async function showOutput(number_) {
  const output = opened.get(number_);
  const {log} = await output.questions.begin().ask(`/api/jobs/${number_}/log`);
  output.text = log || 'nothing printed yet';
  const shown = $('job-list').querySelector(`[data-job="${number_}"] pre`);
  if (shown) shown.textContent = output.text;
}

// Of the whole job, not of its stage.
const progressBar = (job) => h('progress', {max: 1, 'aria-label': `progress of job ${job.number}`,
  ...(Number.isFinite(job.progress?.share) ? {value: job.progress.share} : {})});

function jobRow(job) {
  const act = (what) => async ({target}) => {
    const reply = target.parentElement.querySelector('.reply');
    reply.textContent = {stop: 'stopping …', again: 'starting …'}[what];
    try { keepJob(await ask(`/api/jobs/${job.number}/${what}`, {})); if (what === 'again') reply.textContent = 'started above'; }
    catch (error) { reply.textContent = inFolder(error.message); }
  };
  const bar = job.ended === null ? progressBar(job) : '';
  const look = ({target}) => {
    if (!opened.delete(job.number)) { opened.set(job.number, {text: '', questions: new Questions()}); showOutput(job.number); }
    target.closest('li').querySelector('pre').hidden = !opened.has(job.number);
  };
  return h('li', {'data-job': job.number, 'data-state': job.ended === null ? 'running' : job.exit_code},
    h('div', {}, h('code', {}, job.command)), h('div', {class: `state ${job.ended !== null && job.exit_code ? 'error' : ''}`}, stateText(job), bar),
    h('div', {class: 'buttons'}, job.ended === null ? h('button', {type: 'button', disabled: job.stopping, onclick: act('stop')}, 'Stop') :
      h('button', {type: 'button', onclick: act('again')}, job.exit_code ? 'Continue' : 'Again'),
    watchable(job) ? h('button', {type: 'button', onclick: () => measure.watch(job)}, 'Watch') : '',
    h('button', {type: 'button', onclick: look}, 'Output'),
    h('button', {type: 'button', onclick: () => navigator.clipboard.writeText(job.command)}, 'Copy'), h('output', {class: 'reply'}, job.stopping ? 'stopping …' : '')),
    h('pre', {hidden: !opened.has(job.number), tabindex: 0}, opened.get(job.number)?.text ?? ''));
}

// What a job asks before it moves something. No comes first; a question keeps its buttons until it stands no more.
function questionRow(job) {
  const {number, text} = job.question, reply = h('output', {class: 'reply'});
  const answer = (yes) => async () => {
    reply.textContent = 'sending …';
    try { await ask('/api/answer', {job: job.number, question: number, yes}); } catch (error) { reply.textContent = error.message; }
  };
  return h('div', {'data-question': `${job.number} ${number}`}, h('strong', {}, `Job ${job.number} asks: `), inFolder(text),
    h('span', {class: 'buttons'}, h('button', {type: 'button', class: 'primary', onclick: answer(false)}, 'No'),
      h('button', {type: 'button', onclick: answer(true)}, 'Yes'), reply));
}

function showQuestions(jobs) {
  const list = $('questions'), asking = jobs.filter((job) => job.question), key = (job) => `${job.number} ${job.question.number}`;
  for (const item of [...list.children]) if (!asking.some((job) => key(job) === item.dataset.question)) item.remove();
  for (const job of asking) if (![...list.children].some((item) => item.dataset.question === key(job))) list.append(questionRow(job));
}

const MOST_JOBS = 8;

// The drawer at the lower edge: closed, it shows the job that runs, or the last one.
function drawer(jobs) {
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

function showJobs(jobs) {
  const before = new Map(state.jobs.map((job) => [job.number, JSON.stringify(job)]));
  state.jobs = jobs;
  const list = $('job-list'), shown = jobs.slice(0, MOST_JOBS);
  for (const job of jobs) answerBeside(job);
  showQuestions(jobs);
  drawer(jobs);
  if (!jobs.length) { list.replaceChildren(h('li', {class: 'quiet'}, 'None yet. Jobs that you start appear here; they continue when this page is closed.')); return; }
  for (const item of [...list.children]) if (!shown.some((job) => String(job.number) === item.dataset.job)) item.remove();
  shown.forEach((job, index) => {
    const item = list.querySelector(`[data-job="${job.number}"]`);
    if (item && before.get(job.number) === JSON.stringify(job) && list.children[index] === item) return;
    const focused = item?.contains(document.activeElement) ? document.activeElement.textContent : null;
    const row = jobRow(job);
    if (list.children[index] === item) {
      item.dataset.state = row.dataset.state;
      refill(item, [...row.children]);
    } else {
      item?.remove();
      list.insertBefore(row, list.children[index] ?? null);
    }
    const kept = list.children[index];
    if (focused && !kept.contains(document.activeElement)) {
      [...kept.querySelectorAll('button')].find((button) => button.textContent === focused)?.focus();
    }
    if (opened.has(job.number)) showOutput(job.number);
    if (job.ended !== null && item) finished(job);
  });
  if (state.workspace) {
    diagnose.jobs();
    for (const one of Printed.all) one.jobs();
    measure.newestTrial();
  }
  live.jobs((job) => measure.watch(job));
}

// Selects the result of a finished job in the step that shows it.
function finished(job) {
  const made = job.writes.map((path) => path.replace(`${state.workspace.root}/`, ''));
  if (job.exit_code !== 0) return;
  if (job.arguments[0] === 'design') design.wanted = made[0];
  if (job.arguments[0] === 'investigate') investigate.wanted = made[0];
  if (job.arguments[0] === 'limits') limits.pages.wanted = made[0];
  if (job.arguments[0] === 'rehearse') rehearse.pages.wanted = made[0];
  if (job.arguments[0] === 'study-design') designs.pages.wanted = made[0];
  if (job.arguments[0] === 'compare') compare.wanted = `${made[0]}/compare.html`;
  if (job.arguments[0] === 'analyze') compare.wanted = `${made[0]}/report.html`;
  if (['diagnose', 'discover'].includes(job.arguments[0])) diagnose.wanted = made.find((path) => path.endsWith('.json'));
  if (state.workspace) STEPS[state.step][1].update(); // the list of files may have arrived before the end of the job
}

// ---- the page ---------------------------------------------------------------------------------------------------------------

// A step with tabs; what is not in sight asks for nothing.
class Tabbed {
  constructor(title, parts) { Object.assign(this, {title, parts}); }

  build() {
    this.tabs = new Tabs(Object.fromEntries(Object.entries(this.parts).map(([name, [text, part]]) => [name, [text, part.build()]])));
    return h('section', {}, h('h2', {}, this.title), this.tabs.list, this.tabs.lead, ...this.tabs.panels);
  }

  update() { this.parts[this.tabs.chosen][1].update(); }
}

const STEPS = {
  predict: ['Predict', new Tabbed('Predict what a hit does', {impact: ['Impact', predict], limits: ['Speed limit', limits], designs: ['Design study', designs]})],
  measure: ['Measure', measure],
  laboratory: ['Laboratory', new Tabbed('Recordings of a laboratory', {import: ['Import', importing], laboratory: ['Describe', laboratory], impacts: ['Impacts', impacts]})],
  compare: ['Compare', compare], diagnose: ['Diagnose', diagnose], add: ['Add', add],
  history: ['History', new Tabbed('How the error fell', {versions: ['Versions', history_], evidence: ['Evidence', evidence]})],
  overlay: ['Overlay', overlay],
  investigate: ['Investigate', new Tabbed('Let the loop run by itself', {loop: ['Investigate', investigate], follow: ['Follow', follow]})],
};
const panels = {};

// Opens a step, and a tab of it; without one the tab that was open before.
function go(step, tab = '') {
  const part = STEPS[step][1], {tabs} = part;
  state.step = step;
  if (tabs && tab && tabs.chosen !== tab) tabs.show(tab);
  const key = tabs ? `${step}/${tabs.chosen}` : step, own = ABOUT[tabs?.chosen];
  if (location.hash === `#${step}`) history.replaceState(null, '', `#${key}`); else location.hash = key; // a step back leaves it again
  tabs?.lead.replaceChildren(leads[key]);
  for (const [name, panel] of Object.entries(panels)) panel.hidden = name !== step;
  for (const button of $('steps').querySelectorAll('button')) {
    if (button.dataset.step === step) button.setAttribute('aria-current', 'step'); else button.removeAttribute('aria-current');
  }
  showAbout({...(own ?? ABOUT[step]), terms: own ? [] : termsOf(step)});
  measure.look();
  if (state.workspace) part.update();
  requestAnimationFrame(fitAll);
}

// The step and the tab of an address; none if there are no such.
function placeOf(hash) {
  const [step, tab] = hash.slice(1).split('/'), tabs = STEPS[step]?.[1].tabs;
  return STEPS[step] ? [step, tabs && tab && tabs.has(tab) ? tab : ''] : null;
}

function listen() {
  const events = new EventSource('/api/events');
  events.addEventListener('jobs', ({data}) => showJobs(JSON.parse(data)));
  events.addEventListener('workspace', ({data}) => {
    state.workspace = JSON.parse(data);
    showFolder();
    STEPS[state.step][1].update();
  });
  events.addEventListener('open', () => { $('lost').hidden = true; });
  events.addEventListener('error', () => { $('lost').hidden = false; });
}

const leads = Object.fromEntries(Object.keys(LEADS).map((key) => [key, lead(key)]));
for (const [name, [text, part]] of Object.entries(STEPS)) {
  $('steps').append(h('li', {}, h('button', {type: 'button', 'data-step': name, onclick: () => go(name)}, text)));
  panels[name] = part.build();
  if (part.tabs) part.tabs.changed = (tab) => go(name, tab); else panels[name].firstChild.after(leads[name]);
  $('middle').append(panels[name]);
}
go(...(placeOf(location.hash) ?? ['predict']));
addEventListener('hashchange', () => {
  const place = placeOf(location.hash);
  if (place && (place[0] !== state.step || place[1] && place[1] !== STEPS[place[0]][1].tabs?.chosen)) go(...place);
});
darkScheme.addEventListener('change', () => { if (predict.answer) predict.paint(); });
listen();
window.impact_rs = {predict, recorded, nodes: live}; // for the browser's console
