// ---- where robot and operator are, and the safety function: `RuleSafety.predict` with the limits that were moved

const UNKNOWN = -2147483648;
const NOBODY = 65535;

const TO_TCP = "distance TCP to operator";
const TO_TCP_FLAT = "distance TCP to operator on the floor";
const TO_LINK = "distance nearest link to operator";
const withinOf = (rectangle, out) => { // a test of x and y
  const [cos, sin] = [Math.cos(rectangle.angle_rad || 0), Math.sin(rectangle.angle_rad || 0)];
  const bound = (edge, side, axis) => (edge === null ? side * Infinity : edge.value + side * out[axis]);
  const [[left, right], [front, back]] = [rectangle.along, rectangle.across]
    .map(([low, high], axis) => [bound(low, -1, axis), bound(high, 1, axis)]);
  return (x, y) => {
    const [along, across] = [x * cos + y * sin, y * cos - x * sin];
    return along > left && along < right && across > front && across < back;
  };
};
const polygonOf = (polygon) => {
  const sides = polygon.sides.map((side) => [Math.cos(side.angle_rad), Math.sin(side.angle_rad), side.metres.value]);
  return (x, y) => {
    for (let n = 0; n < sides.length; n += 1) if (x * sides[n][0] + y * sides[n][1] >= sides[n][2]) return false;
    return true;
  };
};
const STAYS = [0, 0];

const linkOf = () => { // rules.links.ArmPoses and rules.distances.to_links
  const { poses, joints } = tables;
  const count = poses.length / 3;
  const width = joints.length / count;
  const most = Math.min(4, count);
  const [near, away] = [new Int32Array(most), new Float64Array(most)];
  const points = new Float64Array(width + 3);
  return (r, h) => {
    away.fill(Infinity);
    for (let n = 0; n < count; n += 1) {
      const [x, y, z] = [poses[3 * n] - r[0], poses[3 * n + 1] - r[1], poses[3 * n + 2] - r[2]];
      const apart_2 = x * x + y * y + z * z;
      if (apart_2 >= away[most - 1]) continue;
      let k = most - 1;
      for (; k > 0 && away[k - 1] > apart_2; k -= 1) [away[k], near[k]] = [away[k - 1], near[k - 1]];
      [away[k], near[k]] = [apart_2, n];
    }
    points.fill(0);
    let whole = 0;
    for (let k = 0; k < most; k += 1) whole += 1 / (Math.sqrt(away[k]) + 1e-3);
    for (let k = 0; k < most; k += 1) {
      const weight = 1 / (Math.sqrt(away[k]) + 1e-3) / whole;
      for (let i = 0; i < width; i += 1) points[i] += weight * joints[near[k] * width + i];
    }
    points.set(r, width);
    let least = Infinity;
    for (let i = 0; i < width; i += 3) {
      let [along, long] = [0, 0];
      for (let axis = i; axis < i + 3; axis += 1) {
        const way = points[axis + 3] - points[axis];
        along += (h[axis - i] - points[axis]) * way;
        long += way * way;
      }
      const part = Math.min(Math.max(along / Math.max(long, 1e-12), 0), 1);
      const at = [0, 1, 2].map((axis) => h[axis] - points[i + axis] - part * (points[i + 3 + axis] - points[i + axis]));
      least = Math.min(least, Math.hypot(...at));
    }
    return least;
  };
};
let toLink;

const apart = (name, r, h) => { // r: TCP, h: operator, his height that of the TCP where it is unknown
  if (name === TO_LINK) return toLink(r, h);
  if (name === TO_TCP) { // Math.hypot takes several times as long
    const [x, y, z] = [r[0] - h[0], r[1] - h[1], r[2] - h[2]];
    return Math.sqrt(x * x + y * y + z * z);
  }
  return name === TO_TCP_FLAT ? Math.hypot(r[0] - h[0], r[1] - h[1]) : Math.hypot(h[0], h[1]);
};

const insideOf = (region, move) => { // a test of both positions
  const robot = region.robot && withinOf(region.robot, STAYS);
  const nearer = region.nearer.map((near) => [near.distance, near.metres.value + move.threshold_m]);
  const areas = [...region.rectangles.map((rectangle) => withinOf(rectangle, move.zone)), ...region.polygons.map(polygonOf)];
  const asks = region.anywhere || nearer.length > 0 || areas.length > 0;
  return (r, h) => {
    if (robot && !robot(r[0], r[1])) return false;
    if (!asks) return Boolean(robot);
    if (Number.isNaN(h[0])) return false;
    if (region.anywhere) return true;
    for (let n = 0; n < nearer.length; n += 1) if (apart(nearer[n][0], r, h) < nearer[n][1]) return true;
    for (let n = 0; n < areas.length; n += 1) if (areas[n](h[0], h[1])) return true;
    return false;
  };
};

const filled = (region) => region && {
  anywhere: false, nearer: [], rectangles: [], polygons: [], robot: null, ...region,
};
const safetyOf = (moved) => { // moved: by how much each of `rule.moves` is moved
  const rule = facts.rule;
  const limits = rule.limits.map((limit) => {
    const move = { threshold_m: 0, zone: [0, 0] };
    rule.moves.forEach((each, index) => {
      if (each.level !== limit.scaling) return;
      if (each.kind === "zone") for (const axis of each.axes) move.zone[axis] = moved[index];
      else move.threshold_m = moved[index];
    });
    const [rises, falls] = [filled(limit.until) || filled(limit.within), filled(limit.within)];
    return { scaling: limit.scaling, move, within: falls, enters: insideOf(falls, move), leaves: insideOf(rises, move) };
  });
  const simple = limits.every(({ within: one }) => one.nearer.length === 1 && one.nearer[0].distance === TO_TCP
    && !one.anywhere && !one.rectangles.length && !one.polygons.length && !one.robot) && !rule.lags && !rule.law;
  const square = limits.map((one) => (simple ? (one.within.nearer[0].metres.value + one.move.threshold_m) : 0));
  const lawful = (r, h) => {
    const { stop, linear, square: squared, lowest, distance } = rule.law;
    const left = Math.max(apart(distance, r, h) - stop.value, 0);
    const root = Math.sqrt(linear.value ** 2 + 4 * squared.value * left);
    return Math.min(1, Math.max(lowest || 0, (2 * left) / Math.max(linear.value + root, 1e-12)));
  };
  return (r, h, leaving) => {
    if (Number.isNaN(h[0]) && !rule.slows_alone) return rule.alone;
    if (simple) {
      const x = r[0] - h[0];
      const y = r[1] - h[1];
      const z = r[2] - h[2];
      const away = Math.sqrt(x * x + y * y + z * z);
      for (let n = 0; n < limits.length; n += 1) if (away < square[n]) return limits[n].scaling;
      return rule.fastest;
    }
    if (rule.law) return lawful(r, h);
    for (let n = 0; n < limits.length; n += 1) {
      if (leaving ? limits[n].leaves(r, h) : limits[n].enters(r, h)) return limits[n].scaling;
    }
    return rule.fastest;
  };
};

const summed = (array, from, count) => { // steps become values again; both wrap
  for (let at = from + 3; at < from + 3 * count; at += 1) array[at] += array[at - 3];
};
const metres = (array) => Float64Array.from(array, (units) => (units === UNKNOWN ? NaN : units / facts.per_metre));

const peopleOf = () => {
  summed(tables.people, 0, tables.people.length / 3);
  return metres(tables.people);
};
const positionsField = () => { // a field: `at` a point of a task and between two samples, what is s, and was it logged
  summed(tables.paths, 0, tables.paths.length / 3);
  const people = peopleOf();
  const { who } = tables;
  const paths = metres(tables.paths);
  if (tables.poses) toLink = linkOf();
  const r = [0, 0, 0];
  const h = [0, 0, 0];
  let safety, robot, human;
  return {
    spots: tables.people_spots,
    nobody: NOBODY,
    count: tables.spots.length / 3,
    free: (point, spot) => {
      const there = [...paths.subarray(3 * point, 3 * point + 3)];
      const person = [...tables.spots.subarray(3 * spot, 3 * spot + 3)];
      if (Number.isNaN(person[2])) person[2] = there[2];
      const [falls, rises] = [false, facts.rule.lags].map((leaving) => safety(there, person, leaving));
      return (falls + rises) / 2 >= facts.away.part * facts.rule.fastest;
    },
    moved: (by) => { safety = safetyOf(by); },
    at: (point, from, to, weight) => {
      for (let axis = 0; axis < 3; axis += 1) {
        r[axis] = paths[3 * point + axis];
        const now = people[3 * who[from] + axis];
        const between = now + (people[3 * who[to] + axis] - now) * weight;
        h[axis] = Number.isNaN(between) ? now : between;
      }
      if (Number.isNaN(h[2])) h[2] = r[2];
      robot = tables.robot_cells[point];
      human = tables.people_cells[who[weight < 0.5 ? from : to]];
    },
    scaling: (rising) => safety(r, h, rising),
    known: () => human === NOBODY || tables.support[robot * facts.support.operators + human],
  };
};
