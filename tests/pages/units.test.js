import assert from 'node:assert/strict';
import test from 'node:test';
import { chosenUnits, distance, inUnit, lengthUnit, places, setUnits, signedDistance, signedSpeed, speed, units } from '../static/lib/units.js';

const N = '\u202f';

test('metric, unless the address or this browser says imperial', () => {
  assert.equal(chosenUnits('', null), 'metric');
  assert.equal(chosenUnits('', 'imperial'), 'imperial');
  assert.equal(chosenUnits('?units=metric', 'imperial'), 'metric');
  assert.equal(chosenUnits('?units=imperial', null), 'imperial');
  assert.equal(chosenUnits('?units=furlong', 'furlong'), 'metric');
});

test('a length in either unit, with a decimal more of inches, and none of what is not known', () => {
  try {
    assert.deepEqual([units(), lengthUnit(), inUnit(254), places(0), distance(254.4), signedSpeed(-127)], ['metric', 'mm', 254, 0, `254${N}mm`, `\u2212127${N}mm/s`]);
    setUnits('imperial');
    assert.deepEqual([units(), lengthUnit(), inUnit(254), places(1), distance(254), distance(25.4, 1)], ['imperial', 'in', 10, 2, `10.0${N}in`, `1.00${N}in`]);
    assert.deepEqual([signedDistance(25.4), signedSpeed(-127), speed(127), distance(null), inUnit(NaN)], [`+1.0${N}in`, `\u22125.0${N}in/s`, `5.0${N}in/s`, '–', null]);
  } finally {
    setUnits('metric');
  }
});
