import assert from 'node:assert/strict';
import test from 'node:test';
import { css, differing, groups, isColour, partLimits, placeOf, range, same, stepOf, title, typed, valueAt, widely, followed } from '../static/tune/settings.js';
import { begun, changed, edited, profiled, tried } from '../static/tune/state.js';
import { trials } from '../static/tune/trials.js';
import { confirmed } from '../static/lib/warnings.js';

const key = (name, kind, low, high, more = {}) => ({ name, kind, low, high, unit: '', step: null, default: 0, belongs: 'paper', choices: [], meaning: '', ...more });
const AREA = key('min_area_px2', 'number', 0, 1e8, { unit: 'px²' });
const KERNEL = key('gaussian_kernel_px', 'whole', 1, 31, { unit: 'px', step: 2 });
const SHARE = key('min_radius_share', 'number', 0.002, 1, { unit: 'of the diagonal', default: 0.012, belongs: 'robust' });
const FILL = key('min_fill', 'number', 0, 1);
const RED = key('red_low_1', 'colour', null, null);
const METHOD = key('method', 'choice', null, null, { belongs: 'both' });

test('a key as people read it', () => {
  assert.equal(title(KERNEL), 'gaussian kernel');
  assert.equal(title(FILL), 'min fill');
  assert.equal(range(KERNEL), '1 to 31, odd');
  assert.equal(range(SHARE), '0.002 to 1');
});

test('every key stands in one group, but those of red, which have controls of their own', () => {
  const all = [AREA, KERNEL, SHARE, FILL, METHOD];
  const parts = groups([...all, RED]);
  assert.deepEqual(Object.values(parts).flat().map((one) => one.name).sort(), all.map((one) => one.name).sort());
  assert.deepEqual(parts.clean, [KERNEL]);
  assert.deepEqual(parts.gates, [AREA, FILL]);
});

test('which settings differ; colours are lists', () => {
  assert.equal(same([0, 43, 46], [0, 43, 46]), true);
  assert.equal(same([0, 43, 46], [0, 43, 47]), false);
  assert.deepEqual(differing([RED, FILL], { red_low_1: [1, 2, 3], min_fill: 0 }, { red_low_1: [1, 2, 3], min_fill: 0.5 }), ['min_fill']);
});

test('a colour is # and six hex digits', () => {
  for (const good of ['#e7752a', '#E7752A', '#000000']) assert.equal(isColour(good), true, good);
  for (const bad of ['e7752a', '#e7752', '#e7752ag', '#e77 2a', 'red', '', null]) assert.equal(isColour(bad), false, bad);
});

test('what is typed is taken only where the gateway would take it', () => {
  assert.equal(typed(KERNEL, '7'), 7);
  for (const bad of ['8', '33', '-1', '', ' ', 'x', '7.5', 'Infinity', '1e400']) assert.equal(typed(KERNEL, bad), null, bad);
  assert.equal(typed(FILL, '0.25'), 0.25);
  assert.equal(typed(FILL, '0,25'), 0.25);
  assert.equal(typed(FILL, '1.01'), null);
  assert.equal(typed(AREA, '1e8'), 1e8);
});

test('a wide range is laid out by powers of ten, and comes back to itself', () => {
  assert.equal(widely(AREA), true);
  assert.equal(widely(KERNEL), false);
  assert.equal(placeOf(AREA, 0), 0);
  assert.equal(placeOf(AREA, 1e8), 1000);
  assert.equal(valueAt(AREA, 0), 0);
  assert.equal(valueAt(AREA, 1000), 1e8);
  let last = -1;
  for (let place = 0; place <= 1000; place += 1) {
    const value = valueAt(AREA, place);
    assert.ok(value >= last && value <= 1e8, `${place}: ${value}`);
    if (value >= 10) assert.ok(Math.abs(placeOf(AREA, value) - place) <= 3, `${place}: ${value}`);
    last = value;
  }
});

test('sliders move as finely as the key asks', () => {
  assert.equal(stepOf(KERNEL), 2);
  assert.equal(stepOf(SHARE), 0.001);
  assert.equal(stepOf(FILL), 0.01);
  assert.equal(stepOf(key('coast_s', 'number', 0, 10)), 0.05);
});

test('low never lies above high', () => {
  const settings = { red_low_1: [3, 43, 46], red_high_1: [10, 255, 200] };
  assert.deepEqual(partLimits('red_low_1', 0, settings), [0, 10]);
  assert.deepEqual(partLimits('red_high_1', 0, settings), [3, 180]);
  assert.deepEqual(partLimits('red_high_1', 2, settings), [46, 255]);
});

test('colours on the file\'s scale', () => {
  assert.equal(css([0, 255, 255]), 'rgb(255, 0, 0)');
  assert.equal(css([60, 255, 255]), 'rgb(0, 255, 0)');
  assert.equal(css([120, 255, 255]), 'rgb(0, 0, 255)');
  assert.equal(css([180, 255, 255]), 'rgb(255, 0, 0)');
  assert.equal(css([90, 0, 128]), 'rgb(128, 128, 128)');
});

/** Trials whose answers come when the test says so. */
function bench() {
  const asked = [];
  const told = [];
  const made = trials(
    (wish) => new Promise((done, fail) => asked.push({ wish, done, fail })),
    { done: (result, wish) => told.push([result, wish.n]), failed: (error, wish) => told.push([error.message, wish.n]), busy: (on) => told.push(on) },
    { quickMs: 1, restMs: 40 },
  );
  return { asked, told, made };
}
const ms = (n) => new Promise((done) => setTimeout(done, n));
const until = async (holds) => {
  for (let n = 0; n < 2000 && !holds(); n += 1) await ms(5);
  assert.ok(holds());
};

test('a newer running picture does not take the place of a measurement, waiting or under way', async () => {
  const { asked, made } = bench();
  made.want({ n: 1 });
  await until(() => asked.length === 1);
  await ms(80); // the measurement waits behind the look
  made.want({ n: 2 }, { timed: false });
  await ms(20);
  asked[0].done('look');
  await until(() => asked.length === 2);
  assert.deepEqual([asked[1].wish.n, asked[1].wish.timed], [1, true]);
  made.want({ n: 3 }, { timed: false });
  await ms(20);
  assert.equal(asked.length, 2);
  asked[1].done('measured');
  await ms(5);
  made.want({ n: 4 }, { timed: false });
  await until(() => asked.length === 3);
  assert.deepEqual([asked[2].wish.n, asked[2].wish.timed], [4, false]);
  made.close();
});

test('while one runs only the newest wish waits', async () => {
  const { asked, told, made } = bench();
  made.want({ n: 1 }, { timed: false });
  await until(() => asked.length === 1);
  for (const n of [2, 3, 4]) {
    made.want({ n }, { timed: false });
    await ms(5);
  }
  await ms(20);
  assert.equal(asked.length, 1);
  asked[0].done('first');
  await until(() => asked.length === 2);
  assert.equal(asked[1].wish.n, 4);
  asked[1].done('last');
  await until(() => told.at(-1) === false);
  assert.deepEqual(told, [true, ['first', 1], true, ['last', 4], false]);
  made.close();
});

test('when the controls rest the time is measured; a newer wish does not wait for that, and its answer is not shown', async () => {
  const { asked, told, made } = bench();
  made.want({ n: 1 });
  await until(() => asked.length === 1);
  asked[0].done('look');
  await until(() => asked.length === 2);
  assert.equal(asked[1].wish.timed, true);
  made.want({ n: 2 });
  await until(() => asked.length === 3);
  asked[1].fail(new Error('given up'));
  asked[2].done('newer');
  await until(() => told.filter(Array.isArray).length === 2);
  made.close();
  assert.deepEqual(told.filter(Array.isArray), [['look', 1], ['newer', 2]]);
});

test('after a failure the next wish is tried; after the end nothing is told', async () => {
  const { asked, told, made } = bench();
  made.want({ n: 1 }, { timed: false });
  await until(() => asked.length === 1);
  asked[0].fail(new Error('busy'));
  await until(() => told.at(-1) === false);
  made.want({ n: 2 });
  await until(() => asked.length === 2);
  made.close();
  asked[1].done('late');
  await ms(80);
  assert.deepEqual(told, [true, ['busy', 1], false, true]);
  assert.equal(asked.length, 2);
});

test('when what is in force changes, keys that nobody has touched follow and the others stay', () => {
  const was = { a: 1, red: [1, 2, 3], c: 5 };
  const draft = { a: 1, red: [1, 2, 9], c: 5 };
  assert.deepEqual(followed(draft, was, { a: 2, red: [4, 5, 6], c: 5 }), { a: 2, red: [1, 2, 9], c: 5 });
  assert.deepEqual(followed(was, was, { a: 2, red: [4, 5, 6], c: 5 }), { a: 2, red: [4, 5, 6], c: 5 });
});

/** A gateway with `warnings` about the settings, and what was sent to it. */
const gate = (...warnings) => {
  const sent = [];
  return { sent, act: async (accepted) => {
    sent.push(accepted);
    const open = warnings[Math.min(sent.length - 1, warnings.length - 1)];
    if (open.some((id) => !accepted.includes(id))) throw Object.assign(new Error('refused'), { body: { error: 'warnings', warnings: open.map((id) => ({ id })) } });
    return 'live';
  } };
};

test('warnings are accepted one list after the other; without any there is no question', async () => {
  const none = gate([]);
  assert.equal(await confirmed(none.act, () => assert.fail('asked')), 'live');
  const asked = [];
  const more = gate(['a'], ['a', 'b']);
  assert.equal(await confirmed(more.act, async (list) => asked.push(list.map((one) => one.id))), 'live');
  assert.deepEqual([asked, more.sent], [[['a'], ['a', 'b']], [[], ['a'], ['a', 'b']]]);
});

test('a score that runs is waited for before anybody is asked, and once only', async () => {
  const refusal = (...warnings) => Object.assign(new Error('refused'), { body: { error: 'warnings', warnings } });
  const dusk = { id: 'dusk: not scored []', bay: 'bay1', test_set: 'dusk', scoring: true };
  const dawn = { ...dusk, id: 'dawn: not scored []', test_set: 'dawn' };
  const busy = { ...dawn, scoring: false }; // others are being scored: it has not begun
  const answers = [refusal(dusk, busy), refusal(dusk, dawn), refusal(dusk, dawn)];
  const act = async (accepted) => { if (answers.length) throw answers.shift(); return accepted; };
  const waited = [];
  const wait = async (warnings) => waited.push(warnings.map((one) => one.test_set));
  assert.deepEqual(await confirmed(act, async () => true, wait), [dusk.id, dawn.id]);
  assert.deepEqual(waited, [['dusk'], ['dawn']]);
  assert.equal(await confirmed(async () => { throw refusal(dusk); }, () => assert.fail('asked'), async () => false), null);
});

test('who does not accept the warnings changes nothing; another refusal is no question', async () => {
  const one = gate(['a']);
  assert.equal(await confirmed(one.act, async () => false), null);
  assert.equal(one.sent.length, 1);
  const broken = async () => { throw Object.assign(new Error('no'), { body: { error: 'refused' } }); };
  await assert.rejects(confirmed(broken, () => assert.fail('asked')), /no/);
});

test('what is told to be in force: edits stay, the rest follows, and a file that was not asked for is the same', () => {
  const profile = (vision, more = {}) => ({ vision, undo_steps: 0, undo: {}, untried: [], function_check: 'off', ...more });
  let page = begun(profile({ a: 1, b: 2 }, { file: { path: 'f' } }), []);
  page = changed(page, edited({ a: 5 }));
  page = changed(page, profiled(profile({ a: 3, b: 4 }, { undo_steps: 1, function_check: 'may_move_off' })));
  assert.deepEqual([page.inForce, page.settings], [{ a: 3, b: 4 }, { a: 5, b: 4 }]);
  assert.deepEqual([page.undoSteps, page.mode, page.file.path], [1, 'MAY_MOVE_OFF', 'f']);
  assert.equal(changed(page, { mode: 'MAY_MOVE_OFF' }), page);
});

test('a look keeps the times that were measured for the same settings, and none of others', () => {
  const side = (ms) => ({ total_ms: ms, stages: [] });
  const trial = (ms, frame_id, timed) => ({ timed, frame_id, time_ratio: ms, exposure: timed ? 'judged' : null, tried: side(ms), in_force: side(ms) });
  const wish = { settings: {}, inForce: {}, source: { kind: 'live' } };
  let page = changed({ result: null, trouble: 'no picture' }, tried(trial(8, 1, true), { ...wish, timed: true }));
  page = changed(page, tried(trial(99, 2, false), { ...wish, timed: false }));
  assert.deepEqual([page.trouble, page.result.frame_id, page.result.tried.total_ms, page.result.exposure, page.result.judged_id], ['', 2, 8, 'judged', 1]);
  assert.equal(changed(page, tried(null, wish)).result, page.result);
  page = changed(page, tried(trial(99, 3, false), { ...wish, settings: { a: 1 }, timed: false }));
  assert.deepEqual([page.result.timed, page.result.tried.total_ms, page.result.judged_id], [false, 99, 3]);
});
