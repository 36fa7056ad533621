import assert from 'node:assert/strict';
import { test } from 'node:test';
import { readPicture } from '../../src/link/protocol';
import { eachNode, MapFrame, wholeWorld } from '../../src/map/mapview';
import { between } from '../../src/math/flight';
import { lonLatOf } from '../../src/math/lonlat';
import type { Pose } from '../../src/math/pose';
import { chartOf, ticks, toSvg } from '../../src/measure/chart';
import { toCsv, toGeoJson } from '../../src/measure/export';
import { climbs, groundLength, planArea, planLength, stationsAlong } from '../../src/measure/geometry';
import { fromHash, toHash } from '../../src/state/address';
import { kindOfSun, nextSun, withClock, zoneOf } from '../../src/state/sun';
import type { World } from '../../src/link/protocol';

const POSE: Pose = { x: 560_000, y: 5_116_000, z: 3500, heading: 350, pitch: -24, roll: 0, vfov: 60 };
const WORLD = { name: 'w', crs: 'UTM 10N', epsg: 32610, bounds: [[0, 0], [2000, 1000]], heights: [0, 10] } as unknown as World;

const near = (found: number, expected: number, tolerance: number) =>
  assert.ok(Math.abs(found - expected) <= tolerance, `expected ${expected}, found ${found}`);

test('a flight between poses begins and ends at them, and turns the shorter way', () => {
  const end = { ...POSE, x: 561_000, z: 800, heading: 20 };
  assert.deepEqual(between(POSE, end, 0, 500), POSE);
  assert.deepEqual({ ...between(POSE, end, 1, 500), heading: 20 }, end);
  near((between(POSE, end, 0.5, 500).heading + 360) % 360, 5, 1e-9);
});

test('a view goes through the address', () => {
  const pose = { ...POSE, x: 560_000.12345, roll: -3.5 };
  const read = fromHash(toHash(pose))!;
  near(read.x, pose.x, 5e-4);
  assert.equal(read.roll, -3.5);
  assert.equal(fromHash(''), undefined);
  assert.equal(fromHash('#x=1&y=2&z=abc&heading=0&pitch=0'), undefined);
  assert.equal(fromHash('#x=1&y=2&z=3&heading=0&pitch=-100'), undefined);
});

test('the sun of a setting, and one by the clocks of the place', () => {
  assert.deepEqual([null, 'OFF', 'auto', '120, -3', '2026-06-21 05:45'].map(kindOfSun), ['off', 'off', 'auto', 'angles', 'time']);
  const now = new Date('2026-06-21T03:00Z');
  // 127.5 degrees west: it is still the day before there.
  assert.equal(nextSun('time', { ...WORLD, bounds: [[499_000, 0], [501_000, 1000]] }, now), '2026-06-20T09:00-08:00');
  assert.equal(nextSun('time', { ...WORLD, epsg: null }, now), '2026-06-21T09:00Z');
  assert.equal(nextSun('auto', undefined, now), 'auto');
  assert.equal(withClock('2026-06-21T05:45:30-07:00', '2026-01-02T03:04'), '2026-01-02T03:04-07:00');
  assert.equal(withClock('2026-06-21T05:45', '2026-01-02T03:04'), '2026-01-02T03:04Z');
  assert.deepEqual(['2026-06-21T05:45Z', '2026-06-21T05:45', '2026-06-21T05:45+0530'].map(zoneOf), ['UTC', 'UTC', 'UTC+0530']);
});

test('longitudes and latitudes are those of PROJ', () => {
  // pyproj, EPSG:4326 to EPSG:32610.
  for (const [x, y, lon] of [
    [562493.7271392485, 5116588.096568971, -122.19],
    [723739.383723068, 5120357.748034838, -120.1],
  ] as const) {
    const found = lonLatOf(32610, x, y)!;
    near(found.lon, lon, 1e-8);
    near(found.lat, 46.2, 1e-8);
  }
  near(lonLatOf(3857, 111319.49079327358, 0)!.lon, 1, 1e-9);
  assert.equal(lonLatOf(25832, 0, 0), undefined);
});

test('lengths, areas and climbs', () => {
  const square: [number, number, number][] = [[1e6, 5e6, 0], [1e6 + 100, 5e6, 0], [1e6 + 100, 5e6 + 100, 0], [1e6, 5e6 + 100, 0]];
  assert.equal(planArea(square), 10_000);
  assert.equal(planArea([...square].reverse()), 10_000);
  assert.equal(planLength(square), 300);
  const stations = stationsAlong(square, 30);
  assert.equal(stations.length, 31);
  assert.equal(stations[30]!.along, 300);
  const slope = stations.map((station) => ({ ...station, height: station.along * 0.75 }));
  near(groundLength(slope), 375, 1e-9);
  near(climbs(slope).up, 225, 1e-9);
  assert.equal(climbs(slope).down, 0);
});

test('a profile is drawn with gaps where there is no ground, and exported', () => {
  const profile = [0, 10, 20, 30, 40].map((along) => ({ x: along, y: 0, along, height: along === 20 ? null : along }));
  const chart = chartOf(profile, 400, 100)!;
  assert.equal(chart.lines.length, 2);
  assert.match(toSvg(profile, 'a < b & c'), /a &lt; b &amp; c/);
  assert.equal(toCsv(profile).split('\n')[3], '20,20,0,');
  const geo = JSON.parse(toGeoJson('area', [[0, 0, 1], [1, 0, 1], [1, 1, 1]], [], WORLD));
  assert.equal(geo.features[0].geometry.type, 'Polygon');
  assert.equal(geo.features[0].geometry.coordinates[0].length, 4);
  assert.equal(geo.crs.properties.name, 'urn:ogc:def:crs:EPSG::32610');
  assert.deepEqual(ticks(0, 10, 5), [0, 2, 4, 6, 8, 10]);
});

test('places of the map and of the world lead to each other, and the world fits', () => {
  const frame = new MapFrame(wholeWorld(WORLD, 300, 200), 300, 200);
  const [u, v] = frame.toMap(0, 1000);
  assert.ok(u > 0 && v > 0 && u < 300 && v < 200);
  const [x, y] = frame.toWorld(u, v);
  near(x, 0, 1e-9);
  near(y, 1000, 1e-9);
});

test('nodes of the quad tree lie where their numbers say', () => {
  const world = { ...WORLD, bounds: [[100, 200], [2100, 1200]], node_side: [64, 32] } as unknown as World;
  const found: number[][] = [];
  eachNode([3, 1, 0, 0, 5, 2], world, (...node) => found.push(node));
  assert.deepEqual(found, [[3, 100 + 512, 200, 100 + 1024, 200 + 256], [0, 100 + 320, 200 + 64, 100 + 384, 200 + 96]]);
});

test('the header of a picture is read, and what is not one is left alone', () => {
  const message = new ArrayBuffer(131);
  const view = new DataView(message);
  new Uint8Array(message).set([0x54, 0x56, 0x50, 0x46, 1, 0, 128, 0]);
  view.setUint32(8, 7, true);
  view.setUint8(12, 1);
  view.setUint8(13, 13);
  view.setUint32(24, 960, true);
  view.setUint32(32, 42, true);
  view.setFloat64(40, 560_000.5, true);
  const { header, file } = readPicture(message)!;
  assert.equal(file.byteLength, 3);
  assert.deepEqual(
    [header.n, header.kind, header.isAtRest, header.hasAllTiles, header.isExact, header.width, header.poseId, header.pose.x],
    [7, 'png', true, false, true, 960, 42, 560_000.5],
  );
  view.setUint16(6, 500, true);
  assert.equal(readPicture(message), undefined);
  assert.equal(readPicture(new ArrayBuffer(20)), undefined);
});
