// ---- a network: itself (`network`) near the edges of its levels, elsewhere a table of where it is certain (`scaling_grid`)

const FLAT = -1000; // height of the nodes for operators of unknown height

const gridField = () => {
  const { grid, book, classifies, lags, margin_m: margin, sure, alone } = facts.rule;
  const nodes = tables.nodes.length / 3;
  const table = tables.scaling;
  for (let at = nodes; at < table.length; at += 1) table[at] += table[at - nodes]; // steps become values; they wrap
  summed(tables.paths, 0, tables.paths.length / 3);
  const paths = metres(tables.paths);
  const people = peopleOf();
  const { who } = tables;
  const network = networkOf();
  const rowOf = new Float64Array(paths.length / 3); // of the table, for each point of a motion
  let row = 0;
  Object.values(facts.legs).forEach((leg, n) => {
    const rows = facts.rule.rows[n];
    for (let k = 0; k < leg.points; k += 1) rowOf[leg.first + k] = row + (k / Math.max(leg.points - 1, 1)) * (rows - 1);
    row += rows;
  });
  const ends = [0, 1, 2].map((axis) => {
    let [low, high] = [Infinity, -Infinity];
    for (let n = 0; n < nodes; n += 1) {
      const at = tables.nodes[3 * n + axis];
      if (axis === 2 && at === FLAT) continue;
      [low, high] = [Math.min(low, at), Math.max(high, at)];
    }
    return low > high ? [0, 0] : [low, high];
  });
  const sizes = ends.map(([low, high]) => high - low + 1);
  const number = new Int32Array(sizes[0] * sizes[1] * (sizes[2] + 1)).fill(-1); // the last layer is the flat one
  const placeOf = (x, y, z) => {
    const [a, b, c] = [x - ends[0][0], y - ends[1][0], z === FLAT ? sizes[2] : z - ends[2][0]];
    if (a < 0 || b < 0 || c < 0 || a >= sizes[0] || b >= sizes[1] || c > sizes[2]) return -1;
    return (c * sizes[1] + b) * sizes[0] + a;
  };
  for (let n = 0; n < nodes; n += 1) number[placeOf(...tables.nodes.subarray(3 * n, 3 * n + 3))] = n;
  const [r, h] = [[0, 0, 0], [0, 0, 0]];
  let near, far, robot, human, flat, bounded, low, high;

  const looked = (who) => { // the number of the value around an operator there; -1: the network is to be asked
    const [left, front] = [Math.floor(who[0] / grid.edge_m), Math.floor(who[1] / grid.edge_m)];
    const z = grid.layers > 1 && !flat ? who[2] / grid.height_m : 0;
    const below = Math.floor(z);
    let all = -1;
    for (let n = 0; n < (z === below ? 4 : 8); n += 1) {
      const place = placeOf(left + (n & 1), front + ((n >> 1) & 1), flat ? FLAT : below + (n >> 2));
      if (place < 0 || number[place] < 0) return -1;
      const value = table[near + number[place]];
      if (value !== table[far + number[place]] || value === grid.ask || (n && value !== all)) return -1;
      all = value;
    }
    return all;
  };
  const valueAt = (who) => { // TrainedModel.predict
    const found = looked(who);
    if (found >= 0) return book[found];
    const out = network(r, who);
    let value = classifies ? 0 : out[0];
    if (classifies) for (let n = 0; n < book.length; n += 1) value += book[n] * out[n];
    return Math.min(Math.max(value, 0), 1);
  };
  const levelAt = (who) => { // likeliest_of: the level, and whether it is sure
    const found = looked(who);
    if (found >= 0) return [book[found], true];
    const out = network(r, who);
    let best = 0;
    for (let n = 1; n < out.length; n += 1) if (out[n] > out[best]) best = n;
    return [book[best], out[best] >= sure];
  };
  const ahead = [0, 0, 0]; // half of the hysteresis, from the TCP to the operator
  const beside = [0, 0, 0];
  const asked = [0, 0, 0];
  const moved = (by, sign) => {
    for (let axis = 0; axis < 3; axis += 1) asked[axis] = h[axis] + sign * by[axis];
    return asked;
  };
  const boundsOf = () => { // Follower.bounds: up to which s may rise, down to which it must fall
    let certain;
    if (classifies) {
      [low, certain] = levelAt(h);
      high = low;
      if (certain) return;
    }
    const long = Math.max(apart(TO_TCP, r, h), 1e-9);
    for (let axis = 0; axis < 3; axis += 1) ahead[axis] = ((h[axis] - r[axis]) * margin) / 2 / long;
    if (!classifies) {
      low = valueAt(moved(ahead, -1));
      high = valueAt(moved(ahead, 1));
      return;
    }
    const wide = Math.max(Math.sqrt(ahead[0] ** 2 + ahead[1] ** 2), 1e-9);
    beside[0] = (-ahead[1] * margin) / 2 / wide;
    beside[1] = (ahead[0] * margin) / 2 / wide;
    for (let n = 0; n < 4; n += 1) {
      const level = levelAt(moved(n < 2 ? ahead : beside, n % 2 ? 1 : -1))[0];
      low = Math.min(low, level);
      high = Math.max(high, level);
    }
  };
  return {
    moved: () => {},
    at: (point, from, to, weight) => {
      const [before, after] = [who[from], who[to]];
      for (let axis = 0; axis < 3; axis += 1) {
        r[axis] = paths[3 * point + axis];
        const now = people[3 * before + axis];
        const between = now + (people[3 * after + axis] - now) * weight;
        h[axis] = Number.isNaN(between) ? now : between;
      }
      flat = Number.isNaN(h[2]);
      if (flat) h[2] = r[2];
      const at = rowOf[point];
      near = Math.floor(at) * nodes;
      far = at > Math.floor(at) ? near + nodes : near;
      robot = tables.robot_cells[point];
      human = tables.people_cells[weight < 0.5 ? before : after];
      bounded = false;
    },
    scaling: (rising) => {
      if (Number.isNaN(h[0])) return alone;
      if (!lags) return valueAt(h);
      if (!bounded) boundsOf();
      bounded = true;
      return rising ? low : high;
    },
    known: () => human === NOBODY || tables.support[robot * facts.support.operators + human],
  };
};
