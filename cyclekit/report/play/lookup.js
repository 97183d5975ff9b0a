// ---- a model on states of the operator: `scaling_table`, points of the motions by states

const lookupField = () => {
  const { cells: width, fastest } = facts.rule;
  const { who } = tables;
  const steps = new Map(Array.from(tables.steps, (entry, n) => [entry, tables.step_parts[n]]));
  let near, far, share, now;
  return {
    spots: Array.from({ length: width }, (_, state) => state),
    nobody: null,
    count: width,
    free: (point, cell) => tables.scaling[point * width + cell] >= facts.away.part * fastest,
    moved: () => {},
    at: (point, next, part, from) => { [near, far, share, now] = [point, next, part, who[from]]; },
    scaling: () => {
      const [first, second] = [tables.scaling[near * width + now], tables.scaling[far * width + now]];
      if (first === second || share <= 0) return first;
      const step = steps.get(near * width + now);
      if (step !== undefined) return share < step ? first : second;
      return first + (second - first) * share;
    },
    known: () => tables.support[(share < 0.5 ? near : far) * width + now],
  };
};
