// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Texts for a reader who has not read the paper: the first two lines of every step, its explanation, and the terms with
// a sketch.

/**
 * By step, or by step and tab: what it is, what it says before there is anything, and what comes next, where.
 * @type {Record<string, {what: string, empty: string, next: string, to: string}>}
 */
export const LEADS = {
  'predict/impact': {
    what: 'The velocities of robot and object just after an impact, computed before it happens.',
    empty: 'Computing …',
    next: 'test the prediction in trials',
    to: 'measure',
  },
  'predict/limits': {
    what: 'The fastest hit at which joints, torques and the robot\'s own reflexes stay within their bounds in ' +
      '99 % of all draws.',
    empty: 'No speed limit has been computed yet.',
    next: 'rehearse the hit with a stand-in for the robot\'s driver',
    to: 'measure/rehearse',
  },
  'predict/designs': {
    what: 'Robots, poses, motor inertias and pads, ranked by the effect of a hit on object and joints.',
    empty: 'No design has been ranked yet.',
    next: 'predict one of these hits',
    to: 'predict/impact',
  },
  'measure/campaign': {
    what: 'A series of trials: the robot hits each object repeatedly, and every signal is recorded.',
    empty: 'No campaign yet.',
    next: 'compare the trials with the model',
    to: 'compare',
  },
  'measure/trial': {
    what: 'A single trial: one hit and the push after it, recorded as one bag.',
    empty: 'No single trial yet.',
    next: 'repeat it as a campaign',
    to: 'measure/campaign',
  },
  'measure/design': {
    what: 'The next trials, chosen so that they best show what the model lacks.',
    empty: 'No plan yet.',
    next: 'diagnose the measurements',
    to: 'diagnose',
  },
  'measure/rehearse': {
    what: 'The trial of a real cell with a stand-in for the robot\'s driver: a checklist with the margin to ' +
      'every bound.',
    empty: 'No rehearsal yet.',
    next: 'see how fast the arm may hit',
    to: 'predict/limits',
  },
  'measure/recorded': {
    what: 'Recorded trials, and runs of a laboratory, in 3D and as signals over time.',
    empty: 'Nothing has been recorded yet.',
    next: 'overlay several of them',
    to: 'overlay/runs',
  },
  'measure/live': {
    what: 'Running nodes, in 3D and with their latest signals.',
    empty: 'The nodes are watched while this tab is open.',
    next: 'look at the recorded trials',
    to: 'measure/recorded',
  },
  'measure/blind': {
    what: 'A practice campaign with a hidden effect: the truth stays secret until you reveal it.',
    empty: 'No practice campaign yet.',
    next: 'diagnose it',
    to: 'diagnose',
  },
  'laboratory/import': {
    what: 'Recordings of your own robot: each column is identified from its numbers, and the evidence is shown.',
    empty: 'No folder of recordings yet.',
    next: 'check each signal',
    to: 'laboratory/laboratory',
  },
  'laboratory/laboratory': {
    what: 'A folder of recordings, described by hand: source and unit of each signal, object and condition of ' +
      'each run.',
    empty: 'No folder of recordings yet.',
    next: 'find the impacts in it',
    to: 'laboratory/impacts',
  },
  'laboratory/impacts': {
    what: 'The impacts in recorded runs, as a table with one row each: the velocities before and after, and ' +
      'their noise.',
    empty: 'No table of impacts yet.',
    next: 'compare them with the model',
    to: 'compare',
  },
  compare: {
    what: 'Model and measurements side by side: how large the error is, and where.',
    empty: 'No comparison yet.',
    next: 'find the cause of the error',
    to: 'diagnose',
  },
  diagnose: {
    what: 'Faults of the readings, and the physical effect that the model lacks, judged on held-out data.',
    empty: 'No diagnosis yet.',
    next: 'add the effect to the model or the calibration',
    to: 'add',
  },
  add: {
    what: 'A better model: the parent model with the effects that a diagnosis found. Faults of the readings ' +
      'go into a calibration.',
    empty: 'There is only the nominal model.',
    next: 'see whether the error falls',
    to: 'history',
  },
  'history/versions': {
    what: 'The error from model to model: it falls where a reading was wrong or an effect was missing.',
    empty: 'No history yet.',
    next: 'overlay estimates and runs',
    to: 'overlay',
  },
  'history/evidence': {
    what: 'A finding as one file that another laboratory can check, and the pooled findings of several laboratories.',
    empty: 'No package of evidence yet.',
    next: 'overlay estimates and runs',
    to: 'overlay',
  },
  'overlay/runs': {
    what: 'Recorded trials in one figure, with their impacts at time 0.',
    empty: 'Nothing has been recorded yet.',
    next: 'let the loop run by itself',
    to: 'investigate',
  },
  'overlay/models': {
    what: 'Predictions of several models for one measured run.',
    empty: 'No comparison yet.',
    next: 'let the loop run by itself',
    to: 'investigate',
  },
  'overlay/estimates': {
    what: 'The estimates of one parameter, over the time of their measurements.',
    empty: 'No diagnosis yet.',
    next: 'let the loop run by itself',
    to: 'investigate',
  },
  'investigate/loop': {
    what: 'The whole loop without you: trials, comparison, diagnosis and better model, in rounds.',
    empty: 'No investigation yet.',
    next: 'predict with the improved model',
    to: 'predict',
  },
  'investigate/follow': {
    what: 'Learning from hit to hit: each hit is predicted, updates the estimated parameters, and is tested ' +
      'for a change of the cell.',
    empty: 'No hits have been followed yet.',
    next: 'diagnose the change',
    to: 'diagnose',
  },
};

/**
 * @typedef {{title: string, text?: string, equation?: string, units?: string, page?: string, command?: string,
 *   facts?: string[], actions?: Node[], terms?: Node[]}} About
 */

/** By step, or by its tab: the explanation in the right column. @type {Record<string, About>} */
export const ABOUT = {
  predict: {
    title: 'Impact map',
    text: 'The impact map gives the velocities just after an impact from those just before it. Bodies are ' +
      'rigid, the impact is instantaneous, and finite forces are neglected. B is the reflected inertia of the ' +
      'motors: B_θ with the torque loop, B_ρ of the rotors without it.',
    equation: '(M + B)(v⁺ − v⁻) = J_cᵀ Λ\nw = Jₙ v⁺ + e min(Jₙ v⁻, 0)\n0 ≤ Λₙ ⊥ w ≥ 0\n|Λₜ| ≤ µ Λₙ, against sliding',
    units: 'm/s, rad/s; impulses in N s; axes of the world frame',
    page: 'physics.md',
  },
  measure: {
    title: 'Trials',
    text: 'A trial is one hit and the push after it, recorded as one bag. A campaign repeats it for ' +
      'post-impact references below and above the prediction. Run an interrupted campaign again to continue ' +
      'it.',
    equation: 'a_fb,net = ∫ a_fb dt from T_nom − 0.1 s to T_nom + 0.6 s',
    units: 'none for scales (reference over prediction)',
    page: 'bags.md',
  },
  design: {
    title: 'A plan of trials',
    text: 'All trials that the cell can run are simulated under every explanation. The plan takes those that ' +
      'most raise the probability that the next diagnosis distinguishes two explanations. With a diagnosis, ' +
      'the plan separates the explanations that it left tied; without one, it searches for the missing ' +
      'effect.',
    units: 'probabilities in percent',
    page: 'design.md',
  },
  limits: {
    title: 'Speed limit',
    text: 'The hit is simulated many times with random draws of the uncertain quantities: the uncertainties ' +
      'of the scenario, stiffness and damping, and the difference between simulators. A speed is allowed if ' +
      'all bounds hold in 99 % of the draws. A reflex is a stop that the robot triggers by itself.',
    units: 'closing speed along the normal of the pad, m/s',
    page: 'limits.md',
  },
  designs: {
    title: 'Design study',
    text: 'The hit of every combination is predicted. The uncertainties of the scenario give each value an ' +
      'interval and each rank a range.',
    units: 'impulse in N s, speeds in m/s; joint jump over the velocity limit',
    page: 'design_study.md',
  },
  rehearse: {
    title: 'Rehearsal',
    text: 'Arming, cell, controller, brake and watchdog are the ones used with a real robot; the driver is a ' +
      'stand-in with the rates, latencies and limits of its profile. A negative margin fails the rehearsal.',
    units: 'given with each number',
    page: 'limits.md#rehearsal',
  },
  import: {
    title: 'Import',
    text: 'Positions lie within the limits of the robot, velocities are their derivative, and torques fit ' +
      'gravity and inertia. ASSUMED marks values that the data do not show: check them.',
    units: 'as in the files; the mapping names them',
    page: 'your_data.md',
  },
  impacts: {
    title: 'Impacts',
    text: 'Positions on both sides of an impact are fitted: joints by parabolas, the object as sliding or ' +
      'flying. Impacts that give no row are listed with the reason.',
    units: 'in the header of each column',
    page: 'your_data.md',
  },
  follow: {
    title: 'Follow',
    text: 'The scatter is learned from the first hits. A change is announced with its first hit, its evidence ' +
      'and the effects that explain it. At most one alarm in 10,000 hits is false if the noise is Gaussian ' +
      'and as large as in the first hits; a slow drift raises more.',
    units: 'given with each number',
    page: 'following.md',
  },
  evidence: {
    title: 'Evidence',
    text: 'A package holds a model, its diagnosis, digests of the measurements, and versions. A merge pools ' +
      'each parameter over the laboratories and names any that disagrees.',
    units: 'those of the parameters',
    page: 'exchange.md',
  },
  laboratory: {
    title: 'Runs of another controller',
    text: 'A robot pushes a box with its own controller. Joint states, torques and motion capture of the box ' +
      'are enough. Each run has a twin: an open-loop simulation driven by the recorded torque.',
    units: 'the mapping names the unit of each signal',
    page: 'your_data.md',
  },
  compare: {
    title: 'Score',
    text: 'The score is one number for all signals and conditions, in multiples of repeatability (the scatter ' +
      'of repeats). The cells of the map show where the model fails: measured minus model.',
    equation: 'score² = Σ r² / Σ (s²/n + d²)',
    units: 'multiples of repeatability; differences in their own unit',
    page: 'diagnosis.md',
  },
  diagnose: {
    title: 'Diagnosis',
    text: 'Every effect of the library is fitted and judged by its held-out error: the error on conditions ' +
      'that were left out of the search.',
    equation: 'held-out error: before → after',
    units: 'multiples of repeatability',
    page: 'diagnosis.md',
  },
  add: {
    title: 'A better model',
    text: 'The parent model with the effects that were found, and their estimates. Model files are never ' +
      'overwritten, and each names its parent. Faults of the readings go into calibration.yaml, in the folder ' +
      'of the measurements. You write an effect of your own as an arithmetic formula.',
    units: 'given with each parameter',
    page: 'effects.md',
  },
  overlay: {
    title: 'Overlay',
    text: 'Runs are drawn over each other with their impacts at time 0. A pinned run stays chosen and on top, ' +
      'whatever the filter. Estimates have 95 % intervals.',
    units: 'on each axis',
    page: 'workbench.md',
  },
  history: {
    title: 'History',
    text: 'The error from model to model: with the parameters of the file, and held out, where fitting noise ' +
      'does not help.',
    units: 'multiples of repeatability',
    page: 'diagnosis.md',
  },
  investigate: {
    title: 'Investigation',
    text: 'Each round designs trials, predicts and measures them, compares, diagnoses, and adds the missing ' +
      'effect. The investigation ends when no effect is missing, a law holds, or the trials are used up; it ' +
      'names what it cannot decide. Run it again with the same folder to continue it.',
    units: 'multiples of repeatability',
    page: 'investigation.md',
  },
};

// Sketches are 220 x 92; colours are those of the page.
const sketch = (...body) => `<svg viewBox="0 0 220 92" aria-hidden="true">${body.join('')}</svg>`;
const path = (kind, d) => `<path class="${kind}" d="${d}"/>`;
const box = (kind, x, y, width, height, rx = 0) =>
  `<rect class="${kind}" x="${x}" y="${y}" width="${width}" height="${height}"${rx ? ` rx="${rx}"` : ''}/>`;
const disc = (kind, x, y, r) => `<circle class="${kind}" cx="${x}" cy="${y}" r="${r}"/>`;
const symbol = (x, y, text) => `<text x="${x}" y="${y}">${text}</text>`;
const word = (x, y, text) => `<text class="small" x="${x}" y="${y}">${text}</text>`;

/** A horizontal arrow. @param {number} x @param {number} y @param {number} length @param {string} kind */
function arrow(x, y, length, kind) {
  const tip = length > 0 ? 7 : -7;
  return path(kind, `M${x} ${y}h${length}m${-tip} -4l${tip} 4l${-tip} 4`);
}

/** @type {Record<string, {name: string, text: string, svg: string}>} */
export const TERMS = {
  motor_inertia: {
    name: 'B_θ',
    text: 'the motor inertia that an impact feels through the torque loop: more than zero, less than that of the ' +
      'bare rotors (B_ρ). It adds to the inertia of the links.',
    svg: sketch(disc('soft', 34, 42, 24), symbol(34, 47, 'B_θ'),
      path('line', 'M58 42h8l4 -9 8 18 8 -18 8 18 8 -18 4 9h6'), box('soft', 112, 27, 44, 30, 5), symbol(134, 47, 'M'),
      box('object', 170, 25, 34, 34), arrow(122, 17, 26, 'before'),
      word(34, 82, 'motor'), word(84, 82, 'gear'), word(134, 82, 'link'), word(187, 82, 'object')),
  },
  settled: {
    name: 'Settled contact',
    text: 'pad and object once they no longer bounce: they move as one body, with one velocity and one rotation. A ' +
      'grab is compared with this state.',
    svg: sketch(box('soft', 52, 20, 22, 46, 3), box('object', 74, 18, 52, 50), arrow(62, 10, 44, 'after'),
      arrow(100, 78, 44, 'after'), word(30, 47, 'pad'), word(158, 47, 'object')),
  },
  reference: {
    name: 'Reference',
    text: 'the velocity that the controller has to keep after the impact. A campaign tries several, below and above ' +
      'the predicted one.',
    svg: sketch(path('axis', 'M22 10v64h186'), path('before', 'M22 22h76'), path('axis dash', 'M98 12v62'),
      path('soft-line', 'M98 36h104'), path('after', 'M98 46h104'), path('soft-line', 'M98 56h104'),
      word(58, 16, 'before'), word(150, 31, 'above'), word(150, 70, 'below'), word(98, 88, 'impact')),
  },
  net_feedback: {
    name: 'Net feedback',
    text: 'the feedback part of the command, integrated over time around the impact. It is zero where the reference ' +
      'equals the true velocity after the impact: this is the measured value.',
    svg: sketch(path('axis', 'M22 10v68M22 46h186'), path('line', 'M40 66L196 20'), disc('dot', 70, 57, 4),
      disc('dot', 100, 48.5, 4), disc('dot', 130, 39.5, 4), disc('dot', 160, 30.5, 4),
      path('after', 'M108 46v-26m-4 19l4 7l4 -7'), word(108, 15, 'measured'), word(170, 62, 'reference')),
  },
};

/** The terms of a step, in the order in which they occur. @type {Record<string, string[]>} */
export const TERMS_OF = {
  predict: ['motor_inertia', 'settled'], measure: ['reference', 'net_feedback'], laboratory: [], compare: ['settled'],
  diagnose: ['net_feedback', 'motor_inertia'], add: [], history: [], overlay: ['reference'],
  investigate: ['net_feedback', 'reference'],
};
