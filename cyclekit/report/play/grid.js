// ---- a network: `scaling_grid`, points of the motions by nodes around the operator's positions, interpolated

const FLAT = -1000; // height of the nodes for operators of unknown height
const gridField = () => {
  const { grid, book, certain, lags, alone } = facts.rule;
  const nodes = tables.nodes.length / 3;
  const kinds = Math.max(book.length - 1, 1); // tables of log-odds, or one of s
  const size = tables.scaling.length / kinds;
  for (const table of [tables.scaling, tables.rising]) { // steps become values again; both wrap
    for (let at = 0; table && at < table.length; at += 1) if (at % size >= nodes) table[at] += table[at - nodes];
  }
  const people = peopleOf();
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
  const corners = new Int32Array(8);
  const weights = new Float64Array(8);
  const h = [0, 0, 0];
  let count, near, far, share, robot, human;
  const around = () => { // the nodes around a position, and how much each counts
    const [x, y] = [h[0] / grid.edge_m, h[1] / grid.edge_m];
    const [left, front] = [Math.floor(x), Math.floor(y)];
    const flat = Number.isNaN(h[2]);
    const z = grid.layers > 1 && !flat ? h[2] / grid.height_m : 0;
    const below = Math.floor(z);
    let whole = 0;
    count = 0;
    for (let n = 0; n < (z === below ? 4 : 8); n += 1) {
      const [a, b, c] = [n & 1, (n >> 1) & 1, n >> 2];
      const weight = (a ? x - left : 1 - x + left) * (b ? y - front : 1 - y + front) * (c ? z - below : 1 - z + below);
      const place = placeOf(left + a, front + b, flat ? FLAT : below + c);
      if (weight <= 0 || place < 0 || number[place] < 0) continue;
      corners[count] = number[place];
      weights[count] = weight;
      whole += weight;
      count += 1;
    }
    for (let n = 0; n < count; n += 1) weights[n] /= whole;
  };
  const least = 1 / (1 + Math.exp(certain));
  const valueOf = (table, first) => {
    let value = 0;
    for (let n = 0; n < count; n += 1) {
      const at = first + corners[n];
      value += weights[n] * (share > 0 ? table[near + at] * (1 - share) + table[far + at] * share : table[near + at]);
    }
    return value / grid.steps;
  };
  const chanceOf = (value) => { // that s is above a level, from log-odds
    if (lags || value <= 0 || value >= 1) return Number(value > 0.5);
    return (1 / (1 + Math.exp(-(2 * value - 1) * certain)) - least) / (1 - 2 * least);
  };
  return {
    moved: () => {},
    at: (point, next, part, from, to, weight) => {
      [near, far, share] = [point * nodes, next * nodes, part];
      for (let axis = 0; axis < 3; axis += 1) {
        const now = people[3 * from + axis];
        const between = now + (people[3 * to + axis] - now) * weight;
        h[axis] = Number.isNaN(between) ? now : between;
      }
      count = 0;
      if (!Number.isNaN(h[0])) around();
      robot = tables.robot_cells[part < 0.5 ? point : next];
      human = tables.people_cells[weight < 0.5 ? from : to];
    },
    scaling: (rising) => {
      if (!count) return alone;
      const table = rising && lags ? tables.rising : tables.scaling;
      if (!book.length) return valueOf(table, 0);
      let scaling = book[0];
      for (let level = 0; level < kinds; level += 1) {
        scaling += (book[level + 1] - book[level]) * chanceOf(valueOf(table, level * size));
      }
      return scaling;
    },
    known: () => human === NOBODY || tables.support[robot * facts.support.operators + human],
  };
};
