// Decodes payloads (a JSON list of base64 texts on stdin) with npm's sparkplug-payload; prints what it reads as JSON.
'use strict';
const { decodePayload } = require('sparkplug-payload').get('spBv1.0');

// 64 bits do not fit a number of JavaScript.
const exact = (key, value) => value && value.constructor && value.constructor.name === 'Long'
    ? { long: value.toString() } : value;

const payloads = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const read = payloads.map(payload => decodePayload(Buffer.from(payload, 'base64')).metrics.map(metric => [
    metric.name, metric.type || '', metric.value, metric.timestamp, Boolean(metric.isHistorical),
]));
// Object.is: JSON has no negative zero.
const whole = value => Object.is(value, -0) ? { long: '0' } : value;
console.log(JSON.stringify(read.map(metrics => metrics.map(metric => metric.map(whole))), exact));
