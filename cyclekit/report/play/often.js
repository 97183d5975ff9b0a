// ---- the operator comes more or less often: `whatif.alter._as_often`

const kept = new Map();
const remembered = (key, make) => { // the twenty that were asked for last
  const found = kept.has(key) ? kept.get(key) : make();
  kept.delete(key);
  kept.set(key, found);
  if (kept.size > 20) kept.delete(kept.keys().next().value);
  return found;
};

const lookedAt = (names) => { // points of the motions, evenly spread
  const legs = names.map((name) => facts.legs[name]);
  const total = legs.reduce((sum, leg) => sum + leg.points, 0);
  const count = Math.min(facts.away.points, total);
  return Array.from({ length: count }, (_, n) => {
    let at = Math.floor(count > 1 ? (n * (total - 1)) / (count - 1) : 0);
    let leg = 0;
    while (at >= legs[leg].points) { at -= legs[leg].points; leg += 1; }
    return legs[leg].first + at;
  });
};

const awayOf = (names, samples) => {
  const points = lookedAt(names);
  const free = Array.from({ length: field.count }, (_, spot) => points.every((point) => field.free(point, spot)));
  const found = new Uint8Array(COUNT * samples);
  for (let k = 0; k < COUNT; k += 1) {
    for (let i = 0; i < samples; i += 1) {
      const spot = field.spots[tables.who[k * SAMPLES + i]];
      found[k * samples + i] = spot === field.nobody || free[spot] ? 1 : 0;
    }
  }
  return found;
};

const asOften = (frequency, away, samples) => {
  let own = 0;
  let gone = 0;
  for (let k = 0; k < COUNT; k += 1) {
    const last = Math.min(facts.tracks.logged[k], samples);
    own += last;
    for (let i = 0; i < last; i += 1) gone += away[k * samples + i];
  }
  const share = gone / own;
  const stretch = share > 0 ? (1 / frequency - (1 - share)) / share : 0;
  if (share < 0.02 || stretch <= 0) {
    return { unknown: say("too_often", { most: fixed(1 / Math.max(1 - share, NOTHING), 2) }) };
  }
  const at = new Int32Array(COUNT * samples);
  const logged = new Int32Array(COUNT);
  for (let k = 0; k < COUNT; k += 1) {
    let source = 0;
    let end = away[k * samples] ? stretch : 1;
    for (let i = 0; i < samples; i += 1) {
      while (source < samples && end <= i) {
        source += 1;
        end += source < samples && away[k * samples + source] ? stretch : 1;
      }
      at[k * samples + i] = Math.min(source, samples - 1);
      if (at[k * samples + i] < facts.tracks.logged[k]) logged[k] += 1;
    }
  }
  return { at, logged };
};
