// ---- a network: itself near the edges of its levels, elsewhere a table of where it is certain (`scaling_grid`)

const FLAT = -1000; // height of the nodes for operators of unknown height

const networkOf = () => { // Weights._block of one row: TCP and operator, m
  const { widths, known, distance, softmax_after: softmaxAfter } = facts.rule.network;
  const layers = [];
  let at = 0;
  for (let n = 1; n < widths.length; n += 1) {
    const [from, to] = [widths[n - 1], widths[n]];
    const weight = Float64Array.from(tables.weights.subarray(at, at + from * to));
    const bias = Float64Array.from(tables.weights.subarray(at + from * to, at + (from + 1) * to));
    layers.push({ from, to, weight, bias, out: new Float64Array(to) });
    at += (from + 1) * to;
  }
  const inputs = new Float64Array(widths[0]);
  const active = new Int32Array(Math.max(...widths) + 3); // where the weights of the values begin that are not 0
  const held = new Float64Array(active.length);
  inputs.fill(1, 6, 6 + known); // known: the TCP always, an operator who is asked about
  return (r, h) => {
    for (let axis = 0; axis < 3; axis += 1) [inputs[axis], inputs[3 + axis]] = [r[axis], h[axis]];
    if (distance) inputs[6 + known] = Math.hypot(r[0] - h[0], r[1] - h[1], r[2] - h[2]);
    let values = inputs;
    for (let n = 0; n < layers.length; n += 1) {
      const { from, to, weight, bias, out } = layers[n];
      out.set(bias);
      let count = 0;
      for (let i = 0; i < from; i += 1) if (values[i] !== 0) [active[count], held[count++]] = [i * to, values[i]];
      for (let k = count; k < count + 3; k += 1) [active[k], held[k]] = [0, 0];
      for (let k = 0; k < count; k += 4) { // four at once; half of the values are 0
        const [p, q, s, t] = [active[k], active[k + 1], active[k + 2], active[k + 3]];
        const [a, b, c, d] = [held[k], held[k + 1], held[k + 2], held[k + 3]];
        for (let o = 0; o < to; o += 1) out[o] += a * weight[p + o] + b * weight[q + o] + c * weight[s + o] + d * weight[t + o];
      }
      if (n === softmaxAfter) {
        const most = Math.max(...out);
        let sum = 0;
        for (let o = 0; o < to; o += 1) sum += (out[o] = Math.exp(out[o] - most));
        for (let o = 0; o < to; o += 1) out[o] /= sum;
      } else if (n < layers.length - 1) for (let o = 0; o < to; o += 1) if (out[o] < 0) out[o] = 0;
      values = out;
    }
    return values;
  };
};

const gridField = () => {
  const { grid, book, classifies, lags, margin_m: margin, sure, alone } = facts.rule;
  const nodes = tables.nodes.length / 3;
  const table = tables.scaling;
  for (let at = nodes; at < table.length; at += 1) table[at] += table[at - nodes]; // steps become values; they wrap
  summed(tables.paths, 0, tables.paths.length / 3);
  const paths = metres(tables.paths);
  const people = peopleOf();
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
  let near, far, robot, human, flat, bounds;

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
    const value = classifies ? book.reduce((sum, level, n) => sum + level * out[n], 0) : out[0];
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
  const boundsOf = () => { // Follower.bounds: up to which s may rise, down to which it must fall
    const way = h.map((value, axis) => value - r[axis]);
    const long = Math.max(Math.hypot(...way), 1e-9);
    const ahead = way.map((value) => (value * margin) / 2 / long);
    const wide = Math.max(Math.hypot(ahead[0], ahead[1]), 1e-9);
    const side = [(-ahead[1] * margin) / 2 / wide, (ahead[0] * margin) / 2 / wide, 0];
    const moved = (by, sign) => h.map((value, axis) => value + sign * by[axis]);
    if (!classifies) return [valueAt(moved(ahead, -1)), valueAt(moved(ahead, 1))];
    const [level, certain] = levelAt(h);
    if (certain) return [level, level];
    const levels = [moved(ahead, -1), moved(ahead, 1), moved(side, -1), moved(side, 1)].map((who) => levelAt(who)[0]);
    return [Math.min(level, ...levels), Math.max(level, ...levels)];
  };
  return {
    moved: () => {},
    at: (point, next, part, from, to, weight) => {
      for (let axis = 0; axis < 3; axis += 1) {
        const here = paths[3 * point + axis];
        r[axis] = here + (paths[3 * next + axis] - here) * part;
        const now = people[3 * from + axis];
        const between = now + (people[3 * to + axis] - now) * weight;
        h[axis] = Number.isNaN(between) ? now : between;
      }
      flat = Number.isNaN(h[2]);
      if (flat) h[2] = r[2];
      const at = rowOf[point] + (rowOf[next] - rowOf[point]) * part;
      near = Math.floor(at) * nodes;
      far = at > Math.floor(at) ? near + nodes : near;
      robot = tables.robot_cells[part < 0.5 ? point : next];
      human = tables.people_cells[weight < 0.5 ? from : to];
      bounds = null;
    },
    scaling: (rising) => {
      if (Number.isNaN(h[0])) return alone;
      if (!lags) return valueAt(h);
      bounds = bounds || boundsOf();
      return bounds[rising ? 0 : 1];
    },
    known: () => human === NOBODY || tables.support[robot * facts.support.operators + human],
  };
};
