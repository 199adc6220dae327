// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Laboratory: recordings of other robots are imported, described by hand, and searched for impacts.

import {says} from '../about.js';
import {draw, erase, plotPlace} from '../figures.js';
import {commandForm, experimentOf, free, takeTable} from '../forms.js';
import {Printed} from '../jobs.js';
import {go, Tabbed} from '../navigation.js';
import {reading} from '../results.js';
import {
  ask, button, commandLine, count, fill, h, inFolder, labelled, LatestRequest, messageArea, note, number, plain,
  query, refill, slug, state, table,
} from '../tools.js';
import {compare} from './compare.js';
import {diagnose} from './diagnose.js';
import {follow} from './investigate.js';

/** @typedef {import('../types.d.ts').Step} Step */

// ---- import -------------------------------------------------------------------------------------------------------

/** Recordings whose columns are identified from their numbers. @implements {Step} */
class ImportPart {
  build() {
    const form = this.form = commandForm('import', 'Look at the files', {ready: () => form.value('files').length,
      suggest: {output: () => form.value('files')[0] ?? ''}}); // with the recordings, where the other steps find it
    this.none = note('Copy a folder of recordings (bags, CSV, Parquet, NPZ, NPY, MAT or HDF5) into this folder: it ' +
      'appears here.');
    this.printed = new Printed('import', (job) => says('laboratory/import', job.exit_code === 0 ?
      `Job ${job.number} has described ${inFolder(job.writes[0])}.` : ''));
    return h('div', {}, this.none, form.node, this.printed.node);
  }

  update() {
    this.none.hidden = state.workspace.laboratories.length > 0;
    this.form.update();
    this.printed.update();
  }
}

// ---- impacts ------------------------------------------------------------------------------------------------------

const tableOf = (folder, many) => `impacts/${slug(folder)}${many > 1 ? `_${many}` : ''}.csv`;

/** Impacts in recorded runs, and what can be done with their tables. @implements {Step} */
class ImpactsPart {
  build() {
    const form = this.form = commandForm('impacts', 'Find the impacts', {offers: ['directory'], first: 'directory',
      ready: () => form.value('directory'), suggest: {experiment: () => experimentOf(form.value('directory')),
        output: () => free((many) => tableOf(form.value('directory') ?? 'lab', many), state.workspace?.tables ?? [])}});
    this.none = note('Describe a folder of recordings first, here or with Import.');
    this.printed = new Printed('impacts');
    this.tables = h('div', {id: 'impact-tables'});
    return h('div', {}, this.none, form.node, this.printed.node, this.tables);
  }

  update() {
    const {laboratories, tables} = state.workspace, labs = laboratories.filter((lab) => lab.experiment && !lab.error);
    this.none.hidden = labs.length > 0;
    this.form.offer('directory', plain(labs.map((lab) => lab.path)));
    this.form.update();
    this.printed.update();
    says('laboratory/impacts', tables.length ? `${count(tables.length, 'table')}: ${tables.join(', ')}.` : '');
    refill(this.tables, [...(tables.length ? [h('h3', {}, 'Tables of impacts')] : []),
      ...tables.map((path) => this.row(path))]);
  }

  /** @param {string} path of a table */
  row(path) {
    const use = (text, step, tab, form) => button(text, () => {
      go(step, tab);
      takeTable(form, path, this.scenarioOf(path));
    });
    return h('div', {class: 'actions', 'data-table': path}, h('code', {}, path),
      use('Compare', 'compare', '', compare.form),
      use('Diagnose', 'diagnose', '', diagnose.form), use('Follow', 'investigate', 'follow', follow.form));
  }

  // The scenario of the recordings in which a job has found the impacts of a table.
  scenarioOf(path) {
    const job = state.jobs.find((job) => job.arguments[0] === 'impacts' &&
      job.writes.some((written) => inFolder(written) === path));
    const experiment = job && job.arguments[job.arguments.indexOf('--experiment') + 1];
    return state.workspace.laboratories.find((lab) => lab.experiment && experiment?.endsWith(lab.experiment))?.scenario;
  }
}

// ---- describe by hand ---------------------------------------------------------------------------------------------

const ARM_SIGNALS = [{name: 'position', text: 'joint position'}, {name: 'velocity', text: 'joint velocity'},
  {name: 'torque', text: 'joint torque'}, {name: 'command', text: 'commanded torque', optional: true}];
const OBJECT_POSE = {name: 'object_pose', text: 'pose of the object', optional: true};

const MOTIONS = {turn: 'revolute joints', slide: 'prismatic joints'};

// Where timestamps and rows are in the files of an arm, as far as import has identified them.
const layoutOf = ({proposal: {time, table: rows}}) => ({...(time && {time}), ...(rows && {table: rows})});

/** Source and unit of one signal, with a preview. */
class Signal {
  /**
   * @param {DescribePart} page
   * @param {{name: string, text: string, optional?: boolean}} signal
   * @param {Arm} arm that it belongs to; the clock of a pose is that of the arm
   * @param {number | null} proposed index of its stream
   */
  constructor(page, signal, arm, proposed) {
    const {streams, units} = page.description, pose = signal === OBJECT_POSE;
    this.page = page;
    this.arm = arm;
    this.name = signal.name;
    this.requests = new LatestRequest();
    this.prismatic = pose ? [] : arm.proposal.slides; // by joint
    const title = pose ? signal.text : `${signal.text}${arm.label}`;
    this.source = h('select', {'data-signal': signal.name}, signal.optional ? new Option('not recorded', '') : '',
      ...streams.flatMap((stream, index) => stream.pose === pose ? [new Option(stream.label, String(index))] : []));
    this.source.value = String(proposed ?? (signal.optional ? '' : this.source.options[0]?.value ?? ''));
    const [turning, sliding] = units[signal.name];
    this.slidingUnit = sliding[0]; // SI
    const turns = pose || this.prismatic.some((slides) => !slides) || !this.prismatic.length;
    const unitList = (motion, all) => ({motion, select: h('select', {}, ...all.map((unit) => new Option(unit, unit)))});
    this.units = [...(turns ? [unitList('turn', turning)] : []),
      ...(this.prismatic.some(Boolean) ? [unitList('slide', sliding)] : [])];
    for (const {select} of this.units) {
      for (const unit of [arm.proposal.units[signal.name]].flat()) {
        if ([...select.options].some((option) => option.value === unit)) select.value = unit;
      }
    }
    this.plot = plotPlace(`preview of ${title}`);
    this.line = h('p', {class: 'note', 'aria-live': 'polite'});
    // All signals of an arm have the clock of its joint positions.
    const changed = () => { for (const item of this.name === 'position' ? arm.signals : [this]) item.show(); };
    for (const control of [this.source, ...this.units.map((list) => list.select)]) {
      control.addEventListener('change', changed);
    }
    const mixed = this.units.length > 1;
    const lists = this.units.map(({motion, select}) => labelled(mixed ? `unit, ${MOTIONS[motion]}` : 'unit', select));
    this.node = h('div', {'data-lab-signal': signal.name},
      h('div', {class: `fields ${mixed ? 'mixed' : ''}`}, labelled(title, this.source), ...lists),
      this.line, this.plot);
  }

  /** Stream and unit as a mapping has them; null: not recorded. */
  value() {
    if (this.source.value === '') return null;
    const unitOf = (motion) => (this.units.find((list) => list.motion === motion) ?? this.units[0]).select.value;
    return {...this.page.description.streams[this.source.value].source, unit: this.units.length > 1 ?
      this.prismatic.map((slides) => unitOf(slides ? 'slide' : 'turn')) : this.units[0].select.value};
  }

  clear(text, kind) {
    this.line.className = kind;
    this.line.textContent = text;
    erase(this.plot);
  }

  async show() {
    const turn = this.requests.begin(), {page, arm} = this, source = this.value();
    if (!source) { this.clear('', 'note'); return; }
    try {
      const preview = await turn.ask('/api/laboratory/preview', {path: page.description.path,
        scenario: page.scenario.value,
        arm: arm.name, signal: this.name, source, position: arm.signals[0]?.value() ?? source, joints: arm.joints(),
        command_includes_gravity: arm.gravity.checked, ...layoutOf(arm)});
      const ranges = preview.ranges.map(({low, high, unit}) => `from ${number(low)} to ${number(high)} ${unit}`)
        .join(', ');
      this.line.className = preview.wrong ? 'error' : 'note';
      this.line.textContent = preview.wrong ||
        `${preview.place}; ${preview.samples} samples at ${number(preview.rate)} Hz; ${ranges}`;
      await draw(this.plot, this.figure(preview));
    } catch (error) { this.clear(error.message, 'error'); }
  }

  // Prismatic joints have an axis of their own where others are revolute.
  figure({columns, time, ranges}) {
    const second = ranges.length > 1 ? this.slidingUnit : null;
    const trace = ({name, values, unit}) => ({x: time, y: values, name, mode: 'lines', line: {width: 1.2},
      hovertemplate: `%{y:.4g} ${unit}`, ...(unit === second ? {yaxis: 'y2'} : {})});
    const right = {title: {text: second}, overlaying: 'y', side: 'right', tickmode: 'auto', showgrid: false};
    const layout = {height: 170, margin: {l: 50, r: second ? 50 : 10, t: 6, b: 34}, showlegend: false,
      xaxis: {title: {text: 'time [s]'}}, yaxis: {title: {text: ranges.find((range) => range.unit !== second).unit}}};
    return {data: columns.map(trace), layout: second ? {...layout, yaxis2: right} : layout};
  }
}

/** Joints, signals and gravity of one arm; with a heading where there are several. */
class Arm {
  /** @param {DescribePart} page @param {string} name @param {any} proposal of import */
  constructor(page, name, proposal) {
    const several = Object.keys(page.description.arms).length > 1;
    const named = page.description.streams.some((stream) => stream.joints.length);
    this.name = name;
    this.proposal = proposal;
    this.label = several ? ` of ${name}` : '';
    /** @type {Signal[]} */
    this.signals = [];
    this.names = h('textarea', {class: 'names', rows: several ? 3 : 2,
      onchange: () => { for (const item of this.signals) item.show(); }}, proposal.joints.join(', '));
    this.gravity = h('input', {type: 'checkbox', checked: true, onchange: () => this.signals.at(-1).show()});
    this.signals = ARM_SIGNALS.map((signal) => new Signal(page, signal, this, proposal.signals[signal.name]));
    this.node = h('section', {'data-lab-arm': name}, several ? h('h3', {}, `Arm ${name}, ${proposal.robot}`) : '',
      proposal.said.length ?
        h('details', {'data-lab-said': name}, h('summary', {}, 'Evidence'),
          ...proposal.said.map((line) => note(line))) : '',
      named ?
        labelled(`joints in order, base to tip (${proposal.slides.length} of ${proposal.robot})`, this.names) : '',
      ...this.signals.map((signal) => signal.node),
      h('label', {class: 'tick'}, this.gravity, ' the commanded torque includes gravity compensation'));
  }

  joints() { return this.names.value.split(/[\s,]+/).filter(Boolean); }

  described() {
    const signals = this.signals.map((signal) => [signal.name, signal.value()]).filter(([, value]) => value);
    return {joints: this.joints(), command_includes_gravity: this.gravity.checked, signals: Object.fromEntries(signals),
      ...layoutOf(this)};
  }
}

/** A folder of recordings, described from lists. @implements {Step} */
class DescribePart {
  build() {
    this.requests = new LatestRequest();
    this.turn = this.requests.begin();
    /** @type {string | null} folder that is chosen next */
    this.wanted = null;
    /** @type {string | null} folder whose form is shown */
    this.offered = null;
    this.folder = h('select', {id: 'lab-folder', onchange: () => this.look()});
    this.scenario = h('select', {id: 'lab-scenario', onchange: () => this.look()});
    this.none = note('No recordings in this folder yet: copy a folder with one bag, CSV, Parquet, NPZ or HDF5 file ' +
      'per run into it, and it appears here.');
    this.message = messageArea();
    this.body = h('div', {id: 'lab'});
    this.fields = h('div', {class: 'fields'}, labelled('folder of recordings', this.folder),
      labelled('scenario: robots, boxes', this.scenario));
    return h('div', {}, this.none, this.fields, this.body, this.message.node);
  }

  update() {
    const labs = state.workspace.laboratories;
    this.none.hidden = labs.length > 0;
    this.fields.hidden = !labs.length;
    const first = labs.find((lab) => !lab.experiment)?.path;
    const choices = labs.map(({path, experiment}) => ({value: path,
      text: `${path}${experiment ? ' (described)' : ''}`}));
    fill(this.folder, choices, this.wanted ?? (this.folder.value || first));
    this.wanted = null;
    fill(this.scenario, plain(state.workspace.scenarios), this.scenario.value || 'push');
    if (this.folder.value && this.folder.value !== this.looked) this.look();
    else if (this.offered && this.offered === this.looked && !this.description.table) this.addRows();
  }

  // Recordings that have come since; what is filled in stays.
  addRows() {
    const listed = new Set([...this.rows.children].map((row) => row.getAttribute('data-recording')));
    const lab = state.workspace.laboratories.find((lab) => lab.path === this.looked);
    for (const name of lab?.recordings ?? []) if (!listed.has(name)) this.rows.append(this.row(name));
  }

  async look() {
    const folder = this.looked = this.folder.value, name = this.scenario.value,
      turn = this.turn = this.requests.begin();
    const lab = () => state.workspace.laboratories.find((lab) => lab.path === folder);
    says('laboratory/laboratory', `${folder} is shown.`);
    this.offered = null;
    this.message.show();
    this.body.replaceChildren(reading(folder));
    const before = lab();
    if (before.error) this.message.error(new Error(before.error));
    try {
      const [description, {objects}] = await Promise.all([
        turn.ask(`/api/laboratory?${query({path: folder, scenario: name})}`),
        turn.ask(`/api/scenario?${query({name})}`),
      ]);
      this.description = description;
      this.objects = objects;
      this.offered = folder;
      this.show((lab() ?? before).recordings); // recordings may have come meanwhile
    } catch (error) {
      this.message.error(error);
      this.body.replaceChildren();
    }
  }

  /** @param {string[]} recordings */
  show(recordings) {
    const {description} = this, {table: runTable} = description;
    this.arms = Object.entries(description.arms).map(([name, proposal]) => new Arm(this, name, proposal));
    this.pose = new Signal(this, OBJECT_POSE, this.arms[0], description.object_pose);
    this.world = h('input', {type: 'checkbox', id: 'lab-world'});
    const rows = runTable ? runTable.rows.map(({bag, object, kind, condition}) => [bag, object, kind, condition]) :
      recordings.map((name) => this.row(name));
    const runs = table({}, ['recording', 'object', 'kind', 'condition'], rows);
    this.rows = runs.querySelector('tbody');
    const source = !runTable ? '' : runTable.error ? h('p', {class: 'error'}, runTable.error) :
      note(`From ${runTable.name} of the folder; change it in an editor.`, {id: 'lab-table'});
    this.body.replaceChildren(h('h3', {}, `Signals of ${description.recording}`),
      note('Choose the source and the unit of each signal, and check its plot: are the numbers right?'),
      h('div', {class: this.arms.length > 1 ? 'arms' : ''}, ...this.arms.map((arm) => arm.node)), this.pose.node,
      h('label', {class: 'tick'}, this.world,
        ' the world frame of the tracker differs from that of the robot: estimate it from the contact in the hits'),
      h('h3', {}, 'Runs'), source, runs,
      h('div', {class: 'actions'},
        button('Write experiment.yaml and mapping', () => this.keep(), {class: 'primary', id: 'lab-save'})));
    for (const signal of [...this.arms.flatMap((arm) => arm.signals), this.pose]) signal.show();
  }

  /** One row of the table of runs; object and kind are guessed from the name. @param {string} recording */
  row(recording) {
    const names = Object.entries(this.objects).map(([value, entry]) => new Option(entry.label, value));
    const object = h('select', {'aria-label': `object of ${recording}`}, ...names);
    const kind = h('select', {'aria-label': `kind of ${recording}`}, ...['hit',
      'free motion'].map((entry) => new Option(entry, entry)),
      new Option('leave out', ''));
    const condition = h('input', {'aria-label': `condition of ${recording}`, value: 'case_1'});
    object.value = Object.keys(this.objects).find((entry) => recording.includes(entry)) ?? object.options[0].value;
    if (/free|excite/i.test(recording)) kind.value = 'free motion';
    const enable = () => { object.disabled = kind.value !== 'hit'; };
    kind.addEventListener('change', enable);
    enable();
    const cells = [recording, object, kind, condition].map((cell) => h('td', {}, cell));
    return h('tr', {'data-recording': recording}, ...cells);
  }

  // Rows of the table of runs that are not left out; null: the folder has its own.
  runs() {
    if (this.description.table) return null;
    return [...this.rows.children].map((row) => {
      const [object, kind] = row.querySelectorAll('select');
      return {bag: row.getAttribute('data-recording'), object: kind.value === 'hit' ? object.value : 'none',
        kind: kind.value, condition: row.querySelector('input').value};
    }).filter((run) => run.kind);
  }

  async keep() {
    const folder = this.folder.value, arms = Object.fromEntries(this.arms.map((arm) => [arm.name, arm.described()]));
    const description = {path: folder, scenario: this.scenario.value, object_pose: this.pose.value(),
      world_from_hits: this.world.checked, runs: this.runs(), arms};
    try {
      const {written, remarks, command} = await this.turn.of(ask('/api/laboratory', description));
      this.message.show(h('p', {class: 'good', id: 'lab-written'}, `Written: ${written.join(', ')}.`),
        ...remarks.map((remark) => note(`Note: ${remark}`)), h('p', {}, 'Next:'), commandLine(command),
        h('div', {class: 'actions'}, button('Compare', () => { compare.form.chooseSoon(folder); go('compare'); })));
    } catch (error) { this.message.error(error); }
    this.message.node.scrollIntoView({block: 'nearest'});
  }
}

export const describe = new DescribePart();
export const impacts = new ImpactsPart();
export const laboratory = new Tabbed('Recordings of a laboratory', {import: ['Import', new ImportPart()],
  laboratory: ['Describe', describe], impacts: ['Impacts', impacts]});
