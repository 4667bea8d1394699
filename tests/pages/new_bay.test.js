// What the page that sets up a bay proposes, and what it changes in the file.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { brokerUrl, cameraIsRight, cameraKeys, changesOf, lastingName, lookedAt, nextName, nextUnit, NOTHING_CHOSEN, ofBays, portIsRight, profileBefore, profilePicked, rangerTable, sizesOf, unfinished, usualSize } from '../static/setup/draft.js';

test('the next name and unit id are free', () => {
  assert.equal(nextName([]), 'bay1');
  assert.equal(nextName(['bay1']), 'bay2');
  assert.equal(nextName(['bay2', 'BAY3', 'bay2']), 'bay4');
  assert.equal(nextName(['A', 'B']), 'C');
  assert.equal(nextName(['C', 'B']), 'B-2');
  assert.equal(nextName(['Z']), 'Z-2');
  assert.equal(nextName(['north']), 'north-2');
  assert.equal(nextUnit([]), 1);
  assert.equal(nextUnit([1, 7]), 8);
  assert.equal(nextUnit([247, 1, 2]), 3);
  assert.equal(nextUnit(Array.from({ length: 247 }, (_, n) => n + 1)), null);
});

const MODES = [
  { pixel_format: 'MJPG', width_px: 1280, height_px: 720, rates_hz: [60, 30] },
  { pixel_format: 'YUYV', width_px: 640, height_px: 480, rates_hz: [15] },
  { pixel_format: 'MJPG', width_px: 640, height_px: 480, rates_hz: [25] },
  { pixel_format: 'YUYV', width_px: 160, height_px: 120, rates_hz: [] },
];

test('a camera begins with the size of the paper, at its rate, at most 30 a second', () => {
  const sizes = sizesOf(MODES);
  assert.deepEqual(sizes.map(({ key, rate_hz }) => [key, rate_hz]), [['160x120', 0], ['640x480', 25], ['1280x720', 60]]);
  assert.deepEqual(cameraKeys('/dev/c', usualSize(sizes)), { url: '/dev/c', width_px: 640, height_px: 480, fps: 25 });
  assert.deepEqual(cameraKeys('/dev/c', sizes[2]), { url: '/dev/c', width_px: 1280, height_px: 720, fps: 30 });
  assert.deepEqual(cameraKeys('/dev/c', sizes[0]), { url: '/dev/c', width_px: 160, height_px: 120 });
  assert.deepEqual(cameraKeys('rtsp://c/1', usualSize(sizesOf([]))), { url: 'rtsp://c/1' });
});

test("a broker's user and password are in its URL, whatever is in them", () => {
  assert.equal(brokerUrl({ address: ' broker:1884 ', user: '', password: '' }), 'mqtt://broker:1884');
  assert.equal(brokerUrl({ address: 'mqtts://b', user: 'a@b', password: 'p:/ü' }), 'mqtts://a%40b:p%3A%2F%C3%BC@b');
  assert.equal(brokerUrl({ address: 'ws://b/x', user: 'a', password: '' }), 'ws://a@b/x');
});

const bay = (name, function_check, vision = 'GOOD', range = 'GOOD') => ({
  bay: name, function_check, state: { vision: { quality: { name: vision } }, range: { quality: { name: range } } },
});

test('a bay whose function check is on, or whose camera or ranger is not there, is set up first', () => {
  assert.equal(unfinished([]), '');
  assert.equal(unfinished([bay('A', 'OFF'), bay('B', 'OFF', 'NO_TARGET', 'TOO_FAR')]), '');
  assert.equal(unfinished([bay('A', 'OFF'), bay('B', 'MAY_MOVE_OFF')]), 'B');
  assert.equal(unfinished([bay('A', 'MAY_MOVE_KEPT'), bay('B', 'MAY_MOVE_OFF')]), 'A');
  assert.equal(unfinished([bay('A', 'OFF', 'LINK_DOWN'), bay('B', 'MAY_MOVE_OFF')]), 'A');
  assert.equal(unfinished([bay('A', 'OFF', 'GOOD', 'LINK_DOWN')]), 'A');
  assert.equal(unfinished([{ bay: 'A', function_check: 'OFF', state: null }]), '');
});

test('a lasting name is offered for a device that the file names by its number, and for no other', () => {
  const camera = { url: '/dev/loading-gateway/camera-X1', node: '/dev/video0' };
  assert.equal(lastingName(camera, '/dev/video0'), '/dev/loading-gateway/camera-X1');
  assert.equal(lastingName(camera, '0'), '/dev/loading-gateway/camera-X1');
  assert.equal(lastingName(camera, '/dev/loading-gateway/camera-X1'), '');
  assert.equal(lastingName(camera, '/dev/v4l/by-id/usb-Plant_X1-index0'), '');
  assert.equal(lastingName({ url: '/dev/video0', node: '/dev/video0' }, '/dev/video0'), '');
  assert.equal(lastingName(undefined, '/dev/video0'), '');
});

const draft = (more) => ({
  ...NOTHING_CHOSEN, bay: '', name: 'B', unit: 2, camera: { url: '1', fps: 5 }, size: { width_px: 640, height_px: 480 }, port: '/dev/b', host: 'h', hostBefore: 'h',
  broker: { address: '', user: '', password: '' }, ...more,
});

test('a new bay is one change; another bay is changed key by key', () => {
  assert.deepEqual(changesOf(draft()), [
    { path: ['bays', 'B'], value: { unit_id: 2, camera: { url: '1', fps: 5, width_px: 640, height_px: 480 }, ranger: { port: '/dev/b' } } },
  ]);
  assert.deepEqual(changesOf(draft({ bay: 'A', host: '0.0.0.0', brokerKeys: ['urls', 'password_file'], broker: { address: 'b', user: '', password: '' } })), [
    { path: ['bays', 'A', 'camera', 'url'], value: '1' },
    { path: ['bays', 'A', 'camera', 'fps'], value: 5 },
    { path: ['bays', 'A', 'camera', 'width_px'], value: 640 },
    { path: ['bays', 'A', 'camera', 'height_px'], value: 480 },
    { path: ['bays', 'A', 'ranger', 'port'], value: '/dev/b' },
    { path: ['modbus', 'host'], value: '0.0.0.0' },
    { path: ['mqtt', 'urls'], value: null },
    { path: ['mqtt', 'password_file'], value: null },
    { path: ['mqtt', 'url'], value: 'mqtt://b' },
  ]);
});

test('what a bay keeps is not changed, and a lasting name changes the address alone', () => {
  const kept = { bay: 'A', camera: null, size: null, cameraOwn: true, port: '', portOwn: true };
  assert.deepEqual(changesOf(draft(kept)), []);
  assert.equal(ofBays(changesOf(draft({ ...kept, host: '0.0.0.0' }))), false);
  const lasting = draft({ ...kept, camera: { url: '/dev/l/camera-X1' }, size: { width_px: 1, height_px: 1 } });
  assert.deepEqual(changesOf(lasting), [{ path: ['bays', 'A', 'camera', 'url'], value: '/dev/l/camera-X1' }]);
  assert.equal(ofBays(changesOf(lasting)), true);
  assert.deepEqual(changesOf(draft({ ...kept, port: '/dev/other', portOwn: false })), [{ path: ['bays', 'A', 'ranger', 'port'], value: '/dev/other' }]);
});

test('a camera is right once it was seen, or where the bay has it already', () => {
  const empty = draft({ ...NOTHING_CHOSEN });
  assert.deepEqual([cameraIsRight(empty), portIsRight(empty)], [false, false]);
  assert.deepEqual([cameraIsRight({ ...empty, camera: { url: '1' } }), cameraIsRight(draft())], [false, true]);
  assert.deepEqual([cameraIsRight({ ...empty, cameraOwn: true }), portIsRight({ ...empty, portOwn: true }), portIsRight(draft())], [true, true, true]);
});

test('a network camera: its password is looked with, and goes into no address of the file', () => {
  const camera = { url: 'rtsp://10.0.0.9/main', username: 'a b', password_file: '/s/1' };
  assert.deepEqual(lookedAt(camera, 'p@/1'), { url: 'rtsp://a%20b:p%40%2F1@10.0.0.9/main' });
  assert.deepEqual(lookedAt({ url: '/dev/video0', fps: 5 }, ''), { url: '/dev/video0', fps: 5 });
  const other = draft({ bay: 'A', camera: { url: '/dev/l' }, size: null, port: '', host: 'h' });
  assert.deepEqual(changesOf(other, { url: 'x', username: 'tom', password_file: null }), [
    { path: ['bays', 'A', 'camera', 'url'], value: '/dev/l' }, { path: ['bays', 'A', 'camera', 'username'], value: null },
  ]);
  assert.deepEqual(changesOf({ ...other, camera }, { username: 'tom', password_file: '/s/0' }).map(({ path, value }) => [path[3], value]), Object.entries(camera));
});

test('a ranger with a profile: its keys are looked with and go into the file, the other rangers stay', () => {
  const chosen = draft({ profile: 'waveshare-ai-8ch', rangerKeys: { mm_per_unit: '0.3', baud: '19200', nearest_mm: '' } });
  const table = { port: '/dev/b', profile: 'waveshare-ai-8ch', number: { mm_per_unit: 0.3 }, baud: 19200 };
  assert.deepEqual(rangerTable(chosen, 'waveshare-ai-8ch'), table);
  assert.deepEqual(changesOf(chosen)[0].value.ranger, table);
  const other = { bay: 'A', camera: null, cameraOwn: true };
  assert.deepEqual(changesOf({ ...chosen, ...other }).map(({ path, value }) => [path.slice(3).join('.'), value]), [
    ['port', '/dev/b'], ['profile', 'waveshare-ai-8ch'], ['number.mm_per_unit', 0.3], ['baud', 19200],
  ]);
  assert.deepEqual(changesOf({ ...chosen, ...other, portOwn: true }).map(({ path }) => path[3]), ['port']);
  const settings = { written: { ranger: { profile: 'x' } }, values: { bays: { A: { ranger: { profile: 'y' } } } } };
  assert.deepEqual([profileBefore(draft(), settings), profileBefore(draft(other), settings), profileBefore(draft(), { written: {} })], ['x', 'y', 'none']);
});

test('what was typed for one profile goes into the file with no other, nor with none', () => {
  const typed = draft({ profile: 'waveshare-ai-8ch', rangerKeys: { mm_per_unit: '0.3', baud: '19200' } });
  assert.deepEqual(rangerTable({ ...typed, ...profilePicked('ifm-al1940', 'none') }, 'ifm-al1940'), { port: '/dev/b', profile: 'ifm-al1940' });
  assert.deepEqual(changesOf({ ...typed, ...profilePicked('none', 'none') })[0].value.ranger, { port: '/dev/b' });
  assert.deepEqual(changesOf({ ...typed, ...profilePicked('none', 'x') })[0].value.ranger, { port: '/dev/b', profile: 'none' });
});
