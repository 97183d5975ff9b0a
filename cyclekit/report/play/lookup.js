// ---- a model on states of the operator: `scaling_table`, points of the motions by states

const lookupField = () => {
  const { cells: width, fastest } = facts.rule;
  const { who } = tables;
  let entry;
  return {
    spots: Array.from({ length: width }, (_, state) => state),
    nobody: null,
    count: width,
    free: (point, cell) => tables.scaling[point * width + cell] >= facts.away.part * fastest,
    moved: () => {},
    at: (point, from) => { entry = point * width + who[from]; },
    scaling: () => tables.scaling[entry],
    known: () => tables.support[entry],
  };
};
