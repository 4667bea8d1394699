import test from 'node:test';
import assert from 'node:assert/strict';
import { quantity } from '../static/lib/quantity.js';
import { NONE, age, number, signed } from '../static/lib/format.js';

const units = (shown) => [shown].flat().filter((part) => typeof part === 'object').map((part) => part.props.children);

test('the units of a value stand apart, and nothing of its text is lost', () => {
  const read = (shown) => quantity(shown).map((part) => (typeof part === 'object' ? part.props.children : part)).join('');
  for (const [shown, apart] of [
    [number(12_345.6, 1, 'px'), ['\u202fpx']],
    [signed(-154, 0, 'mm/s'), ['\u202fmm/s']],
    [age(303_000), ['\u202fmin', '\u202fs']],
  ]) {
    assert.deepEqual(units(quantity(shown)), apart);
    assert.equal(read(shown), shown);
  }
});

test('what is more than a value, or none, stays whole', () => {
  for (const shown of ['yes, seen 267\u202fms', NONE, number(7), 'off', null, ['a', 'b']]) assert.equal(quantity(shown), shown);
});
