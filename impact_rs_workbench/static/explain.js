// SPDX-License-Identifier: Apache-2.0
// For a reader who has not read the paper: the first two lines of every step, and the terms with a sketch.

// By step, or by step and tab: what it is, what it says before there is anything, and what comes next, where.
export const LEADS = {
  'predict/impact': {what: 'The velocities of robot and object just after an impact, computed before it happens.', empty: 'Computing …',
    next: 'test it on trials', to: 'measure'},
  'predict/limits': {what: 'The fastest hit at which joints, torques and the robot\'s own reflexes stay within their bounds in 99 % of all draws.',
    empty: 'No speed limit is computed yet.', next: 'rehearse the hit against the robot\'s driver', to: 'measure/rehearse'},
  'predict/designs': {what: 'Robots, poses, motor inertias and pads, ranked by what a hit does to object and joints.',
    empty: 'Nothing is ranked yet.', next: 'predict one of these hits', to: 'predict/impact'},
  'measure/campaign': {what: 'Many trials: the robot hits each object again and again, and every signal is recorded.', empty: 'No campaign yet.',
    next: 'hold it against the model', to: 'compare'},
  'measure/trial': {what: 'One trial: one hit and the push after it, recorded as one bag.', empty: 'No single trial yet.',
    next: 'repeat it as a campaign', to: 'measure/campaign'},
  'measure/design': {what: 'Which trials decide most about what the model lacks, before they run.', empty: 'No plan yet.',
    next: 'diagnose what was measured', to: 'diagnose'},
  'measure/rehearse': {what: 'The trial of a real cell against a stand-in of the robot\'s driver: a checklist with the margin of every bound.',
    empty: 'Nothing is rehearsed yet.', next: 'see how fast the arm may hit', to: 'predict/limits'},
  'measure/recorded': {what: 'Each recorded trial in 3D, above its signals; runs of a laboratory, too.', empty: 'Nothing is recorded yet.',
    next: 'see several over each other', to: 'overlay/runs'},
  'measure/live': {what: 'Running nodes, in 3D and with their newest signals.', empty: 'Nodes are watched while this tab is in sight.',
    next: 'look at what they recorded', to: 'measure/recorded'},
  'measure/blind': {what: 'A campaign whose plant has a hidden effect, to practise on: the truth stays closed until you reveal it.',
    empty: 'No practice campaign yet.', next: 'diagnose it', to: 'diagnose'},
  'laboratory/import': {what: 'Recordings of your own robot: the numbers in the files say what each column is, with the evidence for each guess.',
    empty: 'No folder of recordings yet.', next: 'check signal by signal', to: 'laboratory/laboratory'},
  'laboratory/laboratory': {what: 'A folder of recordings, described by hand: source and unit of each signal, object and condition of each run.',
    empty: 'No folder of recordings yet.', next: 'find the impacts in it', to: 'laboratory/impacts'},
  'laboratory/impacts': {what: 'The impacts in recorded runs, as a table with one row each: velocities before and after, with their noise.',
    empty: 'No table of impacts yet.', next: 'hold it against the model', to: 'compare'},
  compare: {what: 'The model against the measurements: how far it is off, and where.', empty: 'Nothing is compared yet.',
    next: 'find out why', to: 'diagnose'},
  diagnose: {what: 'What is wrong with the readings, and which physical effect the model lacks, judged on data that the search has not seen.',
    empty: 'Nothing is diagnosed yet.', next: 'add the effect to the model or the calibration', to: 'add'},
  add: {what: 'A better model: the parent model with the effects that were found; and a calibration with faults of the readings.', empty: 'There is the nominal model alone.',
    next: 'see whether the error falls', to: 'history'},
  'history/versions': {what: 'The error from model to model: it falls where a reading was wrong or an effect was missing.', empty: 'No history yet.',
    next: 'see estimates and runs over each other', to: 'overlay'},
  'history/evidence': {what: 'What was found as one file that another laboratory can check, and what several laboratories say together.',
    empty: 'No package of evidence yet.', next: 'see estimates and runs over each other', to: 'overlay'},
  'overlay/runs': {what: 'Recorded trials over each other, with their impacts at time 0.', empty: 'Nothing is recorded yet.',
    next: 'let the loop run by itself', to: 'investigate'},
  'overlay/models': {what: 'What several models predict for one run, over what was measured.', empty: 'Nothing is compared yet.',
    next: 'let the loop run by itself', to: 'investigate'},
  'overlay/estimates': {what: 'One parameter, from diagnosis to diagnosis, over the time of its measurements.', empty: 'Nothing is diagnosed yet.',
    next: 'let the loop run by itself', to: 'investigate'},
  'investigate/loop': {what: 'The whole loop by itself: trials, comparison, diagnosis and better model, round after round.',
    empty: 'Nothing is investigated yet.', next: 'predict with what was found', to: 'predict'},
  'investigate/follow': {what: 'Learning from hit to hit: each one is predicted, updates the believed parameters, and shows whether something has changed.',
    empty: 'Nothing is followed yet.', next: 'diagnose what has changed', to: 'diagnose'},
};

// Sketches are 220 x 92; colours are those of the page.
const sketch = (body) => `<svg viewBox="0 0 220 92" aria-hidden="true">${body}</svg>`;
const arrow = (x, y, length, kind) =>
  `<path class="${kind}" d="M${x} ${y}h${length}m${length > 0 ? -7 : 7} -4l${length > 0 ? 7 : -7} 4l${length > 0 ? -7 : 7} 4"/>`;

export const TERMS = {
  motor_inertia: {name: 'B_θ', text: 'the inertia of the motors that an impact still feels behind the torque loop: more than nothing, ' +
    'less than that of the whole rotors (B_ρ). It adds to the inertia of the links.',
  svg: sketch(`<circle class="soft" cx="34" cy="42" r="24"/><text x="34" y="47">B_θ</text><path class="line" d="M58 42h8l4 -9 8 18 8 -18 8 18 8 -18 4 9h6"/>
    <rect class="soft" x="112" y="27" width="44" height="30" rx="5"/><text x="134" y="47">M</text>
    <rect class="object" x="170" y="25" width="34" height="34"/>${arrow(122, 17, 26, 'before')}
    <text class="small" x="34" y="82">motor</text><text class="small" x="84" y="82">gear</text><text class="small" x="134" y="82">link</text><text class="small" x="187" y="82">object</text>`)},
  settled: {name: 'Settled contact', text: 'pad and object once the bouncing is over: they move as one body, with one velocity ' +
    'and one rotation. A grab is compared with it.',
  svg: sketch(`<rect class="soft" x="52" y="20" width="22" height="46" rx="3"/><rect class="object" x="74" y="18" width="52" height="50"/>
    ${arrow(62, 10, 44, 'after')}${arrow(100, 78, 44, 'after')}<text class="small" x="30" y="47">pad</text><text class="small" x="158" y="47">object</text>`)},
  reference: {name: 'Reference', text: 'the velocity that the controller is to keep after the impact. A campaign tries several, ' +
    'below and above the predicted one.',
  svg: sketch(`<path class="axis" d="M22 10v64h186"/><path class="before" d="M22 22h76"/><path class="axis dash" d="M98 12v62"/>
    <path class="soft-line" d="M98 36h104"/><path class="after" d="M98 46h104"/><path class="soft-line" d="M98 56h104"/>
    <text class="small" x="58" y="16">before</text><text class="small" x="150" y="31">above</text><text class="small" x="150" y="70">below</text>
    <text class="small" x="98" y="88">impact</text>`)},
  net_feedback: {name: 'Net feedback', text: 'what the controller adds by feedback around the impact, summed up over time. It is zero where ' +
    'the reference is the velocity that the robot really has: there lies the measured value.',
  svg: sketch(`<path class="axis" d="M22 10v68M22 46h186"/><path class="line" d="M40 66L196 20"/>
    <circle class="dot" cx="70" cy="57" r="4"/><circle class="dot" cx="100" cy="48.5" r="4"/><circle class="dot" cx="130" cy="39.5" r="4"/><circle class="dot" cx="160" cy="30.5" r="4"/>
    <path class="after" d="M108 46v-26m-4 19l4 7l4 -7"/><text class="small" x="108" y="15">measured</text><text class="small" x="170" y="62">reference</text>`)},
};

// The terms of a step, in the order in which they are met.
export const TERMS_OF = {predict: ['motor_inertia', 'settled'], measure: ['reference', 'net_feedback'],
  laboratory: [], compare: ['settled'], diagnose: ['net_feedback', 'motor_inertia'], add: [], history: [], overlay: ['reference'],
  investigate: ['net_feedback', 'reference']};
