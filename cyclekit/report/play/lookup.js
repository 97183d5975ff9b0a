// ---- a model that is no rule of positions: `scaling_table`, points of the motions by cells of the operator

const lookupField = () => {
  const { cells: width, absent, holds, lags, fastest } = facts.rule;
  const cells = tables.people_cells;
  for (const table of [tables.scaling, tables.rising, tables.support]) { // steps become values again; both wrap
    for (let at = width; table && at < table.length; at += 1) table[at] += table[at - width];
  }
  let near, far, share, now, after, weight; // two points and how far between; two cells and how far between
  const of = (table, point, cell) => tables.values[table[point * width + cell]];
  const between = (table, point) => {
    const first = of(table, point, now);
    return weight > 0 && after !== now ? first + (of(table, point, after) - first) * weight : first;
  };
  return {
    spots: cells,
    nobody: absent,
    count: width,
    free: (point, cell) => of(tables.scaling, point, cell) >= facts.away.part * fastest,
    moved: () => {},
    at: (point, next, part, from, to, part_of_step) => {
      [near, far, share, weight] = [point, next, part, part_of_step];
      if (holds) [near, share] = [part < 0.5 ? point : next, 0]; // levels: there is nothing between two
      now = cells[from];
      after = holds || now === absent || cells[to] === absent ? now : cells[to];
    },
    scaling: (rising) => {
      const table = rising && lags ? tables.rising : tables.scaling;
      const first = between(table, near);
      return share > 0 ? first + (between(table, far) - first) * share : first;
    },
    known: () => tables.support[(share < 0.5 ? near : far) * width + (weight < 0.5 ? now : after)],
  };
};
