// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Forms of commands, made from the declarations of the commands. The command is shown while its form is filled in.

import {showAbout} from './about.js';
import {replyArea} from './jobs.js';
import {
  ask, fill, h, labelled, LatestRequest, messageArea, plain, query, refill, slug, state, stem, unit, withUnit,
} from './tools.js';

/** @typedef {import('./types.d.ts').Field} Field */
/** @typedef {import('./types.d.ts').Option} Choice */
/** @typedef {ReturnType<typeof commandForm>} CommandForm */

/** @type {Record<string, {fields: Field[]}>} */
const FORMS = await ask('/api/forms');

const CUT_OFF = 18; // characters that a narrow field shows
const TYPING = 150; // ms without a key, after which a text is checked

// ---- what lies in the folder --------------------------------------------------------------------------------------

/** RUNS of a command: campaigns, folders of several, and described recordings of laboratories. @returns {Choice[]} */
export function runsChoices() {
  const labs = state.workspace.laboratories.filter((lab) => lab.experiment && !lab.error);
  return [...plain(state.workspace.runs), ...labs.map((lab) => ({value: lab.path, text: `${lab.path} (laboratory)`}))];
}

/** The experiment file of a laboratory; empty: it has none. @param {string} runs */
export const experimentOf = (runs) => state.workspace.laboratories.find((lab) => lab.path === runs)?.experiment ?? '';

/** The model that was written last; the nominal one has no file. */
export const newestModel = () => [...state.workspace.models].filter((model) => !model.error)
  .sort((a, b) => (state.workspace.stamps[b.path] ?? 0) - (state.workspace.stamps[a.path] ?? 0))[0].path;

/** @returns {Choice[]} */
export const modelChoices = () => state.workspace.models.filter((model) => !model.error)
  .map((model) => ({value: model.path, text: model.name}));

/** @returns {Choice[]} */
export const diagnosisChoices = () => state.workspace.diagnoses
  .map(({path, verdict, model}) => ({value: path, text: `${path}: ${model}, ${verdict}`}));

/** The first name that is not used yet. @param {(count: number) => string} name @param {string[]} used */
export function free(name, used) {
  let count = 1;
  while (used.includes(name(count))) count += 1;
  return name(count);
}

// Folders of recordings; the only one is ticked.
function recordingFolders() {
  const {laboratories} = state.workspace;
  return laboratories.filter((lab) => lab.recordings.length).map(({path, experiment}) =>
    ({value: path, text: `${path}${experiment ? ' (described)' : ''}`, on: !experiment && laboratories.length === 1}));
}

/**
 * The choices of a field, by its name or its kind: what lies in the folder.
 * @type {Record<string, (field: Field) => Choice[]>}
 */
const CHOICES = {
  plan: () => plain(state.workspace.plans),
  impacts: () => plain(state.workspace.tables),
  calibration: () => plain(state.workspace.calibrations),
  package: () => plain(state.workspace.packages),
  packages: () => plain(state.workspace.packages),
  files: recordingFolders,
  robot: () => plain(state.workspace.robots),
  robots: (field) => [...new Set([...field.default, ...state.workspace.robots])]
    .map((value) => ({value, text: value, on: field.default.includes(value)})),
  folder: runsChoices,
  scenario: () => plain(state.workspace.scenarios),
  runs: runsChoices,
  model: modelChoices,
  experiment: () => plain(state.workspace.laboratories.map((lab) => lab.experiment).filter(Boolean)),
  diagnosis: diagnosisChoices,
  formulas: () => plain(state.workspace.formulas),
};

/** @param {Field} field */
function choicesOf(field) {
  if (field.choices.length || field.kind === 'text') return undefined;
  return CHOICES[field.name] ?? (field.many ? undefined : CHOICES[field.kind]);
}

// ---- fields -------------------------------------------------------------------------------------------------------

/**
 * The control of one field.
 * @typedef {object} Control
 * @property {HTMLElement} node
 * @property {any} [control] the list or the line in it
 * @property {() => any} value undefined: left out
 * @property {(value: any) => void} set
 * @property {(choices: Choice[], wanted?: string) => void} offer
 */

/**
 * @param {Field} field
 * @param {string} id
 * @param {boolean} offered whether a step gives its choices
 * @returns {Control}
 */
function controlOf(field, id, offered) {
  const chosen = offered || field.choices.length > 0 || choicesOf(field) !== undefined;
  if (field.kind === 'switch') return switchOf(field, id);
  if (!chosen) return lineOf(field, id);
  return field.many ? boxesOf(field, id, offered) : listOf(field, id);
}

const textOf = (field) => withUnit(field.label, field.unit);

// What a field shows that is left out.
const blankOf = (field) => field.required ? '' : field.otherwise || (field.default ?? 'none');

/** @param {Field} field @param {string} id @returns {Control} */
function switchOf(field, id) {
  const input = h('input', {type: 'checkbox', id});
  return {node: h('label', {class: 'tick long', title: field.help}, input, field.label),
    value: () => input.checked || undefined,
    set: (value) => { input.checked = value; }, offer() {}};
}

/** @param {Field} field @param {string} id @param {boolean} offered @returns {Control} */
function boxesOf(field, id, offered) {
  const node = h('fieldset', {class: 'checks wide', id, title: field.help}, h('legend', {}, textOf(field)));
  const legend = /** @type {Element} */ (node.firstChild);
  // Choices that a step offers begin anew; of those in the folder the ticks stay.
  const offer = (choices) => {
    const boxes = choices.map(({value, text, on}) =>
      h('label', {}, h('input', {type: 'checkbox', value, checked: on}), text));
    if (!boxes.length) boxes.push(h('label', {class: 'quiet'}, 'none yet'));
    if (offered) node.replaceChildren(legend, ...boxes); else refill(node, [legend, ...boxes]);
  };
  offer(field.choices.map((value) => ({value, text: value, on: field.default?.includes(value)})));
  const ticked = () => [.../** @type {NodeListOf<HTMLInputElement>} */ (node.querySelectorAll('input:checked'))];
  return {node, set() {}, offer,
    value: () => ticked().map(({value}) => field.kind === 'number' ? Number(value) : value)};
}

/** @param {Field} field @param {string} id @returns {Control} */
function listOf(field, id) {
  const select = h('select', {id});
  const none = field.required || field.default ? [] : [{value: '', text: blankOf(field)}];
  const offer = (choices, wanted) =>
    fill(select, field.kind === 'runs' ? [...choices, ...none] : [...none, ...choices], wanted);
  if (field.choices.length) offer(plain(field.choices), field.default);
  return {node: labelled(textOf(field), select, {title: field.help}), control: select, offer,
    value: () => select.value || undefined, set: (value) => { select.value = value; }};
}

/** @param {Field} field @param {string} id @returns {Control} */
function lineOf(field, id) {
  const blank = blankOf(field), numeric = !field.many && ['whole', 'number'].includes(field.kind);
  const bounds = {type: 'number', min: field.least, max: field.most, step: field.kind === 'whole' ? 1 : 0.05};
  const input = h('input', {id, placeholder: field.many && field.default ? field.default.join(' ') : blank,
    ...(numeric ? bounds : {})});
  if (numeric && field.default !== null) input.value = field.default;
  const parts = () => input.value.split(field.kind === 'setting' ? /\s+/ : /[\s,]+/).filter(Boolean);
  const long = field.kind.startsWith('new_') || String(blank).length > CUT_OFF;
  return {node: labelled(textOf(field), input, {title: field.help, class: long ? 'long' : null}),
    control: input, offer() {},
    value: () => input.value === '' ? undefined : field.many ? parts() : numeric ? Number(input.value) : input.value,
    set: (value) => { input.value = value; }};
}

/** @param {string} text */
const sentence = (text) => `${text.charAt(0).toUpperCase()}${text.slice(1)}.`;

// ---- forms --------------------------------------------------------------------------------------------------------

/**
 * The form of a command. The command is shown while the form is filled in, and run as a job on submit.
 * @param {string} command
 * @param {string} label of the button
 * @param {object} [options]
 * @param {string[]} [options.offers] fields whose choices the step gives
 * @param {string} [options.first] the field that comes first
 * @param {Record<string, () => any>} [options.suggest] values of fields that the user has not filled in
 * @param {() => any} [options.ready] whether there is a command to show
 */
export function commandForm(command, label, {offers = [], first = 'scenario', suggest = {}, ready = () => true} = {}) {
  const prefix = command.replaceAll(' ', '-');
  const fields = Object.fromEntries(FORMS[command].fields.map((field) =>
    [field.name, {field, ...controlOf(field, `${prefix}-${field.name}`, offers.includes(field.name))}]));
  const message = messageArea(), run = h('button', {class: 'primary', type: 'submit'}, label);
  const typed = new Set(), all = Object.values(fields), requests = new LatestRequest();
  let before = null; // content of the form, as JSON
  const value = (name) => fields[name].value();
  const contents = () => Object.fromEntries(all.map((entry) => [entry.field.name, entry.value()]));
  const body = () => ready() ? {command, ...contents()} : null;
  const check = async () => {
    const turn = requests.begin();
    await turn.pause(TYPING);
    const content = body();
    if (!content) { message.show(); run.disabled = true; return; }
    try {
      const {command: line} = await turn.ask('/api/command', content);
      message.command(line);
      run.disabled = false;
    } catch (error) { message.error(error); run.disabled = true; }
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
  for (const [name, {field, node}] of Object.entries(fields)) {
    const changed = () => { // a name of results that the user clears is suggested again
      if (field.kind.startsWith('new_') && value(name) === undefined) typed.delete(name); else typed.add(name);
    };
    for (const event of ['input', 'change']) node.addEventListener(event, changed);
    const facts = field.otherwise ? [`Left out: ${field.otherwise}.`] : [];
    const about = {title: field.label, text: sentence(field.help), units: unit(field.unit), facts,
      command: field.spelled};
    node.addEventListener('focusin', () => showAbout(about));
  }
  // Boxes come last.
  const rank = ({field, node}) => field.name === first && !field.advanced ? 0 : node.classList.contains('wide') ? 2 : 1;
  const nodes = (advanced) => all.filter(({field}) => field.advanced === advanced).sort((a, b) => rank(a) - rank(b))
    .map((entry) => entry.node);
  const offerAll = () => {
    for (const {field, offer} of all) {
      if (choicesOf(field) && !offers.includes(field.name)) offer(choicesOf(field)(field));
    }
  };
  const reply = replyArea(), further = nodes(true);
  const submit = (event) => { event.preventDefault(); reply.start(body()); };
  const node = h('form', {novalidate: true, oninput: refresh, onchange: refresh, onsubmit: submit},
    h('div', {class: 'fields'}, ...nodes(false)),
    further.length ?
      h('details', {class: 'more'}, h('summary', {}, 'More options'), h('div', {class: 'fields'}, ...further)) : '',
    // The message stands below the button, which must not move while it is clicked.
    h('div', {class: 'actions'}, run, reply.node), message.node);
  return {
    node, refresh, message,
    /** The value of a field; undefined: left out. @param {string} name */
    value,
    /** @param {string} name */
    has: (name) => name in fields,
    /** @param {string} name */
    field: (name) => fields[name].field,
    /** The list or the line of a field. @param {string} name */
    control: (name) => fields[name].control,
    /** @param {string} name @param {Choice[]} choices @param {string} [wanted] */
    offer: (name, choices, wanted) => fields[name].offer(choices, wanted),
    /** A value of the user's, from elsewhere on the page. @param {string} name @param {any} wanted */
    choose(name, wanted) { offerAll(); typed.add(name); fields[name].set(wanted); refresh(); },
    /** The folder has changed. */
    update() { offerAll(); refresh(); },
  };
}

/**
 * The form of a command that follows the choice of a scenario.
 * @template {{object?: string, case?: string}} Only
 * @param {string} command
 * @param {string} label of the button
 * @param {object} options those of `commandForm`, and
 * @param {string[]} options.offers
 * @param {Record<string, () => any>} [options.suggest]
 * @param {(scenario: any, only: Only, form: CommandForm) => void} options.offer is given what the chosen scenario has
 */
export function scenarioForm(command, label, {offer, ...options}) {
  const requests = new LatestRequest();
  const form = commandForm(command, label, {...options, ready: () => extended.chosenScenario});
  let asked = false;
  const choose = async (only = {}) => {
    const turn = requests.begin();
    extended.chosenScenario = null;
    form.refresh();
    try {
      const scenario = await turn.ask(`/api/scenario?${query({name: form.value('scenario')})}`);
      extended.chosenScenario = scenario;
      offer(scenario, /** @type {Only} */ (only), form);
      form.refresh();
    } catch (error) { form.message.error(error); }
  };
  const extended = {
    ...form,
    /** @type {any} what the chosen scenario has; null: it is being asked for */
    chosenScenario: null,
    /** @param {{scenario: string} & Only} [wanted] hits to choose */
    update(wanted) {
      if (!asked) form.offer('scenario', plain(state.workspace.scenarios), 'push'); // it is first in sight
      form.update();
      if (wanted) form.choose('scenario', wanted.scenario);
      if (!asked || wanted) choose(wanted);
      asked = true;
    },
  };
  form.control('scenario').addEventListener('change', () => choose());
  return extended;
}

/** Objects of a scenario. @returns {[string, string][]} */
export const objectsOf = (scenario) => Object.entries(scenario.objects).map(([key, object]) => [key, object.label]);

/** Cases of a scenario. @returns {[string, string][]} */
export const casesOf = (scenario) => Object.entries(scenario.cases);

/** @param {[string, string][]} entries @returns {Choice[]} */
export const listed = (entries) => entries.map(([value, text]) => ({value, text}));

/** The form of a command about the hits of a scenario. @param {Record<string, () => any>} suggest */
export function hitsForm(command, label, suggest) {
  const names = FORMS[command].fields.map((field) => field.name);
  const offers = ['object', 'objects', 'case', 'cases'].filter((name) => names.includes(name));
  return scenarioForm(command, label, {offers, suggest, offer(scenario, _, form) {
    const give = (kind, entries) => {
      if (form.has(`${kind}s`)) {
        form.offer(`${kind}s`, listed(entries).map((choice, index) => ({...choice, on: index === 0})));
      } else if (form.has(kind)) {
        const {required, otherwise} = form.field(kind);
        form.offer(kind, [...(required ? [] : [{value: '', text: otherwise}]), ...listed(entries)]);
      }
    };
    give('object', objectsOf(scenario));
    give('case', casesOf(scenario));
  }});
}

/** The form of a command on measurements; names of its results follow measurements and model. */
export function runsForm(command, label, suggest = {}) {
  const measured = () => form.value('runs') ?? stem(form.value('impacts') ?? '');
  const folder = () => `reports/${slug(`${command}_${measured()}_${stem(form.value('model') ?? 'nominal')}`)}`;
  const form = commandForm(command, label, {ready: () => form.value('runs') || form.value('impacts'), suggest: {
    runs: () => form.value('runs') ?? runsChoices()[0]?.value ?? '', ...suggest, // each from those before it
    experiment: () => experimentOf(form.value('runs')), output: suggest.output ?? folder}});
  let wanted = null; // runs that will be in the folder soon
  return {
    ...form, folder,
    /** @param {string} runs that may not be in the folder yet */
    chooseSoon(runs) { wanted = runs; },
    update() {
      form.update();
      if (wanted && runsChoices().some(({value}) => value === wanted)) { form.choose('runs', wanted); wanted = null; }
    },
  };
}

/** The measurements of a form are the rows of a table of impacts. @param {CommandForm} form @param {string} table */
export function takeTable(form, table, scenario = '') {
  form.choose('runs', '');
  form.choose('impacts', table);
  if (scenario) form.choose('scenario', scenario);
}
