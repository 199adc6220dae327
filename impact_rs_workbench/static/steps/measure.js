// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Measure: campaigns, single trials, plans of trials, rehearsals, recorded and running trials, and practice.

import {says} from '../about.js';
import {casesOf, commandForm, free, listed, objectsOf, scenarioForm} from '../forms.js';
import {onJobs, onWatch} from '../jobs.js';
import {go, inSight, Tabbed} from '../navigation.js';
import {ImpactScene} from '../picture.js';
import {ask, button, count, h, inFolder, LatestRequest, state, stem} from '../tools.js';
import {design} from './design.js';
import {diagnose} from './diagnose.js';
import {live, watchable, watchJob} from './live.js';
import {PagePart} from './page_part.js';
import {reveal} from './practice.js';
import {recorded, TrialView} from './trials.js';

/** @typedef {import('../types.d.ts').Step} Step */

const TOO_FEW = 'Analyze needs at least two references over the prediction, and three trials of each object and ' +
  'case; Compare and Diagnose do not.';

/** @param {string} object @param {string} case_ @param {number} [scale] */
const trialName = (object, case_, scale = 1) => `${object}__${case_}__s${scale.toFixed(3)}__r0`;

// ---- the hit of a form, in 3D -------------------------------------------------------------------------------------

/** The impact that a form asks for, as the nominal model predicts it. */
class HitScene {
  constructor() {
    this.node = h('div', {class: 'scene', id: 'measure-scene'});
    this.impact = new ImpactScene(this.node);
    this.requests = new LatestRequest();
    /** @type {string | null} the question whose answer is drawn */
    this.shown = null;
  }

  clear() {
    this.requests.begin();
    this.shown = null;
  }

  /** @param {ReturnType<typeof scenarioForm>} form */
  async show(form) {
    const firstOf = (kind) => form.has(`${kind}s`) ? form.value(`${kind}s`)[0] : form.value(kind);
    const question = {scenario: form.value('scenario'), object: firstOf('object'), case: firstOf('case')};
    if (!form.chosenScenario || !question.object || !question.case || JSON.stringify(question) === this.shown) return;
    this.shown = JSON.stringify(question);
    const turn = this.requests.begin();
    try {
      const {moment} = await turn.ask('/api/impact', question);
      await turn.of(this.impact.draw(question.scenario, question.object, moment));
    } catch (error) { this.shown = null; this.node.title = error.message; }
  }
}

// ---- campaigns and single trials ----------------------------------------------------------------------------------

/** @implements {Step} */
class CampaignPart {
  constructor() {
    this.only = ''; // the one object that is wanted
    this.offered = () => {}; // called when the hits of a scenario are offered
  }

  build() {
    this.form = scenarioForm('campaign', 'Start the campaign', {offers: ['objects', 'cases', 'scales'],
      suggest: {trials: () => 2, output: () => `campaigns/${this.name()}`}, offer: (scenario, only, form) => {
        const chosen = (entries, wanted) => listed(entries)
          .map((choice, index) => ({...choice, on: wanted ? choice.value === wanted : index === 0}));
        this.only = only.object ?? '';
        form.offer('objects', chosen(objectsOf(scenario), only.object));
        form.offer('cases', chosen(casesOf(scenario), only.case));
        // All of them: an estimate needs several.
        form.offer('scales', scenario.scales.map((scale) => ({value: scale, text: `${scale}`, on: true})));
        this.count();
        this.offered();
      }});
    this.counted = h('p', {class: 'note', id: 'campaign-count', 'aria-live': 'polite'});
    for (const event of ['input', 'change']) this.form.node.addEventListener(event, () => this.count());
    return h('div', {}, this.form.node, this.counted);
  }

  name() { return `${stem(this.form.value('scenario') ?? 'push')}${this.only ? `_${this.only}` : ''}`; }

  // The number of trials, and whether an analysis needs more.
  count() {
    const [objects, cases, scales] = ['objects', 'cases', 'scales'].map((name) => this.form.value(name).length);
    const {chosenScenario: scenario} = this.form, trials = this.form.value('trials') ?? scenario?.trials;
    const total = objects * cases * scales * trials;
    const few = scenario?.hits && total && (scales < 2 || scales * trials < 3);
    this.counted.textContent = !total ? '' : few ? `${count(total, 'trial')}. ${TOO_FEW}` : `${count(total, 'trial')}.`;
  }

  /** @param {{scenario: string, object: string, case: string}} [wanted] hits to choose */
  update(wanted) { this.form.update(wanted); }
}

/** @implements {Step} */
class TrialPart {
  constructor() {
    this.offered = () => {}; // called when the hits of a scenario are offered
  }

  build() {
    this.form = scenarioForm('trial', 'Run the trial', {offers: ['object', 'case'],
      suggest: {output: () => free((many) => many === 1 ? 'trials' : `trials_${many}`, this.taken())},
      offer: (scenario, _, form) => {
        form.control('scale').max = scenario.largest_scale;
        form.offer('object', listed(objectsOf(scenario)));
        form.offer('case', listed(casesOf(scenario)));
        this.offered();
      }});
    this.view = new TrialView('trial');
    return this.form.node;
  }

  // Folders that the trial cannot go into: they have it already, or are of another kind.
  taken() {
    const {campaigns = [], laboratories = []} = state.workspace ?? {};
    const name = trialName(this.form.value('object'), this.form.value('case'), this.form.value('scale'));
    const others = campaigns.filter((campaign) => campaign.scenario || campaign.error || campaign.loose.includes(name));
    return [...others, ...laboratories].map(({path}) => path);
  }

  update() { this.form.update(); }

  // The newest single trial, in 3D and over time.
  showNewest() {
    this.view.node.hidden = !inSight('measure', 'trial');
    const job = state.jobs.find((job) => job.arguments[0] === 'trial' && job.ended !== null && job.exit_code < 2);
    if (!job || job.number === this.shown || this.view.node.hidden || !state.workspace) return;
    const [, , object, case_, ...flags] = job.arguments, folder = inFolder(job.writes[0]);
    const trial = trialName(object, case_, Number(flags.includes('--scale') ? flags[flags.indexOf('--scale') + 1] : 1));
    if (!state.workspace.campaigns.some((campaign) => campaign.path === folder)) return;
    this.shown = job.number;
    says('measure/trial', `${trial.replaceAll('__', ' ')}, in ${folder}.`);
    this.view.open({path: `${folder}/${trial}`});
  }
}

// ---- rehearsal and practice ---------------------------------------------------------------------------------------

const rehearsal = new PagePart('rehearse', {run: 'Rehearse', label: 'rehearsal', page: 'rehearsal.html',
  output: (part) => `rehearsals/${stem(part.scenario())}`,
  opened: async (folder) => {
    const {scenario, object, case: case_, passed} = await ask(`/files/${folder}/rehearsal.json`);
    says('measure/rehearse', `${scenario}, ${object}, ${case_}: ${passed ? 'passed' : 'not passed'}.`);
  }});

/** Practice campaigns: diagnose one, and reveal what it hid. @implements {Step} */
class PracticePart {
  build() {
    this.form = commandForm('blind make', 'Make the campaign',
      {suggest: {seed: () => 7, output: () => `blind_${this.form.value('seed')}`}});
    this.made = h('div', {id: 'practice'});
    return h('div', {}, this.form.node, this.made);
  }

  update() {
    this.form.update();
    const campaigns = state.workspace.blinds;
    if (JSON.stringify(campaigns) === this.listed) return;
    this.listed = JSON.stringify(campaigns);
    const heading = campaigns.length ? [h('h3', {}, 'Practice campaigns')] : [];
    this.made.replaceChildren(...heading, ...campaigns.map((path) => this.row(path)));
  }

  /** @param {string} path */
  row(path) {
    const answer = h('div', {});
    const use = () => { go('diagnose'); diagnose.form.choose('runs', `${path}/runs`); };
    return h('div', {'data-practice': path}, h('div', {class: 'actions'}, h('code', {}, path),
      button('Diagnose', use), button('Reveal', () => reveal(path, answer))), answer);
  }
}

// ---- the step -----------------------------------------------------------------------------------------------------

const campaign = new CampaignPart(), trial = new TrialPart();

/** @implements {Step} */
class Measure extends Tabbed {
  constructor() {
    super('Measure', {campaign: ['Campaign', campaign], trial: ['Single trial', trial], design: ['Design', design],
      rehearse: ['Rehearsal', rehearsal], recorded: ['Recorded trials', recorded], live: ['Live', live],
      blind: ['Practise', new PracticePart()]});
  }

  /** @override */
  build() {
    const section = super.build();
    this.scene = new HitScene();
    this.columns = h('div', {}, h('div', {}, ...this.tabs.panels), this.scene.node);
    section.append(this.columns, trial.view.node);
    for (const part of [campaign, trial]) {
      part.form.node.addEventListener('change', () => this.showHit());
      part.offered = () => this.showHit();
    }
    onJobs(() => trial.showNewest());
    onWatch(watchable, watchJob);
    return section;
  }

  /** @override */
  update() {
    const {chosen} = this.tabs;
    this.scene.node.hidden = !['campaign', 'trial'].includes(chosen);
    this.columns.className = this.scene.node.hidden ? '' : 'beside';
    if (chosen === 'campaign') { campaign.update(this.wanted); this.wanted = undefined; } else super.update();
    trial.showNewest();
    this.showHit();
  }

  showHit() {
    if (!inSight('measure') || this.scene.node.hidden) this.scene.clear();
    else this.scene.show(this.tabs.chosen === 'trial' ? trial.form : campaign.form);
  }

  /** The campaign of a hit. @param {{scenario: string, object: string, case: string}} hit */
  choose(hit) {
    this.wanted = hit;
    go('measure', 'campaign');
  }
}

export const measure = new Measure();
