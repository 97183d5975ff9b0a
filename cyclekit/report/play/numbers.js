// ---- statistics: `resample`, `history`, `means`, `conformal`

const mean = (values) => {
  let sum = 0;
  for (let n = 0; n < values.length; n += 1) sum += values[n];
  return sum / values.length;
};
const covariance = (one, other) => {
  const [a, b] = [mean(one), mean(other)];
  let sum = 0;
  for (let n = 0; n < one.length; n += 1) sum += (one[n] - a) * (other[n] - b);
  return sum / (one.length - 1);
};
const sorted = (values) => Float64Array.from(values).sort();
const quantile = (ordered, level, conformal = false) => { // linear; conformal: Weibull's ranks
  const last = ordered.length - 1;
  const place = conformal ? (last + 2) * level - 1 : last * level;
  const below = Math.min(Math.max(Math.floor(place), 0), last);
  const above = Math.min(below + 1, last);
  return ordered[below] + (ordered[above] - ordered[below]) * Math.min(Math.max(place - below, 0), 1);
};
const upTo = (ordered, longest) => { // number of values that are no longer
  let [low, high] = [0, ordered.length];
  while (low < high) {
    const at = (low + high) >> 1;
    if (ordered[at] <= longest) low = at + 1; else high = at;
  }
  return low;
};
const shareUpTo = (ordered, until_s) => { // CycleDistribution.share
  const last = upTo(ordered, until_s);
  if (last === 0 || last === ordered.length) return Number(last > 0);
  const below = ordered[last - 1];
  return (last + (until_s - below) / (ordered[last] - below)) / (ordered.length + 1);
};
const shifted = (ordered, less, more) => { // CycleDistribution.shifted
  const middle = quantile(ordered, 0.5);
  return ordered.map((value) => value + (value < middle ? less : value > middle ? more : 0));
};

const interludesIn_s = (orders) => facts.interludes.reduce((sum, { agent, task, before, most_s }) => {
  const order = orders[agent] || []; // interludes.with_interludes
  const again = before.length === 1 && before[0] === task;
  const asked = again ? order.some((each, n) => each === task && order[n + 1] === task) : order.includes(task);
  return asked ? sum : sum + order.filter((each) => before.includes(each)).length * most_s;
}, 0);

const inResamples = (values, which) => { // the mean of the values of these tracks in each resample of the executions
  const executions = tables.drawn.length / tables.errors.length;
  const sum = new Float64Array(executions);
  const size = new Float64Array(executions);
  which.forEach((track, n) => {
    sum[tables.execution[track]] += values[n];
    size[tables.execution[track]] += 1;
  });
  return Float64Array.from(tables.errors, (_, row) => {
    let [all, weight] = [0, 0];
    for (let e = 0; e < executions; e += 1) {
      const drawn = tables.drawn[row * executions + e];
      all += drawn * sum[e];
      weight += drawn * size[e];
    }
    return all / weight;
  });
};

const resampledMeans = (cycles) => { // Rolled.resampled_means, times LogLevel.resampled
  const at = (values) => (tables.level ? values.map((value, row) => value * tables.level[row]) : values);
  const usual = mean(cycles.ownLoss_s) / Math.max(mean(cycles.ownBase_s), NOTHING);
  const resampled = (values) => inResamples(values, cycles.which);
  if (usual <= 0) return at(resampled(cycles.duration_s));
  const [loss, base] = [resampled(cycles.ownLoss_s), resampled(cycles.ownBase_s)];
  const free = resampled(cycles.duration_s.map((value, n) => value - cycles.lost_s[n]));
  const lost = mean(cycles.lost_s);
  return at(free.map((value, row) => value + (lost * (loss[row] / Math.max(base[row], NOTHING))) / usual));
};

const modelError = () => Math.hypot(facts.check.network_error, facts.check.unseen_error);

// ---- the tasks of an order: those of a cycle with other work may stand for longer (`estimate.robot.work_dwells`)

const groupOf = (kind, start, places) => JSON.stringify([kind, start, ...(kind === "order" ? places : [...places].sort())]);
const groupsOf = (places) => [ // the same, most alike first
  groupOf("work", places[0] === places[places.length - 1] ? null : places[0], places.slice(1)),
  groupOf("places", null, [...new Set(places)]),
  groupOf("order", null, places),
];
const namesOf = (places) => places.slice(1).map((place, n) => `${places[n]}->${place}`);
const legsOf = (places) => { // NominalTask.of_work
  const mine = groupsOf(places);
  return namesOf(places).map((name) => {
    const leg = facts.legs[name];
    const stands = new Map(leg.of_work.map((each) => [groupOf(each.group.kind, each.group.start, each.group.places), each]));
    const group = mine.find((each) => stands.has(each));
    return { ...leg, ...stands.get(group), ofAll: stands.size > 0 && group === undefined, groups: stands };
  });
};
const widthOf = (legs) => { // limits.with_work: how much less and more the standstills of other works are, s
  const off = new Map();
  for (const leg of legs.filter((each) => each.ofAll)) {
    for (const [group, each] of leg.groups) {
      off.set(group, (off.get(group) || 0) + each.dwell_s + each.wait_s - leg.dwell_s - leg.wait_s);
    }
  }
  return [Math.min(0, ...off.values()), Math.max(0, ...off.values())];
};

const meansOf = (cycles, legs) => { // means_of: factor, resampled mean and error of the cell as it was logged
  const check = facts.check;
  const resampled = resampledMeans(cycles).map((value) => value * check.factor);
  const alone = { factor: check.factor, resampled, error: modelError() };
  const names = Object.keys(check.history);
  const pooled = legs.every((leg) => leg.name in check.history && !leg.groups.size);
  if (check.order_error === null || !pooled) return alone;
  const rollout_s = mean(cycles.duration_s) * check.factor;
  const history_s = legs.reduce((sum, { name }) => sum + check.history[name], 0);
  const size = tables.errors.length;
  const history = new Float64Array(size);
  for (const { name } of legs) {
    const from = names.indexOf(name) * size;
    for (let row = 0; row < size; row += 1) history[row] += tables.history[from + row];
  }
  const order = check.order_error / Math.sqrt(legs.length);
  const [one, other] = [resampled, history].map((values) => {
    const middle = mean(values);
    return values.map((value) => value / middle);
  });
  const together = covariance(one, other);
  const mine = covariance(one, one) + check.network_error ** 2 - together;
  const its = covariance(other, other) + order ** 2 + (history_s / rollout_s - 1) ** 2 - together;
  const share = mine + its > 0 ? Math.min(Math.max(mine / (mine + its), 0), 1) : 0;
  const expected = rollout_s + share * (history_s - rollout_s);
  return {
    factor: (check.factor * expected) / rollout_s,
    resampled: resampled.map((value, row) => (1 - share) * value + share * history[row]),
    error: Math.hypot((1 - share) * check.network_error, share * order, check.unseen_error),
    moved: expected / rollout_s,
  };
};

const shiftedOf = (values, ordered) => { // the values in their own order, each replaced by that of its rank
  const found = new Float64Array(values.length);
  Array.from(values.keys()).sort((a, b) => values[a] - values[b]).forEach((n, rank) => { found[n] = ordered[rank]; });
  return found;
};
const sharesOfDraws = (single, which, takt_s, bias, error) => sorted(Float64Array.from(tables.errors, (off, row) => { // CycleDistribution
  const executions = tables.drawn.length / tables.errors.length;
  const longest = takt_s / ((1 + bias) * Math.max(1 + error * off, 1e-9));
  let [all, weight] = [0, 0];
  which.forEach((track, n) => {
    const drawn = tables.drawn[row * executions + tables.execution[track]];
    weight += drawn;
    if (single[n] <= longest) all += drawn;
  });
  return all / weight;
}));

const beyondOf = (cycles) => { // Rolled.beyond: after the ends of the logs people stay, or go on
  const [lost, free] = [[0, 0], [0, 0]];
  if (!facts.tracks.stays) return [0, 0];
  cycles.which.forEach((track, n) => {
    const after_s = cycles.duration_s[n] - cycles.ownLoss_s[n] - cycles.ownBase_s[n];
    if (after_s <= NOTHING) return;
    const [stays, lost_s] = [Number(facts.tracks.stays[track]), cycles.lost_s[n] - cycles.ownLoss_s[n]];
    lost[stays] += lost_s;
    free[stays] += after_s - lost_s;
  });
  if (!free[0] || !free[1]) return [0, 0];
  const off = lost.map((value, n) => (value / free[n]) * (free[0] + free[1]) - lost[0] - lost[1]);
  const all = cycles.duration_s.reduce((sum, value) => sum + value, 0);
  return [Math.min(0, ...off) / all, Math.max(0, ...off) / all];
};

const entryOf = (cycles, means, legs, takt_s) => { // entry_of: what the cycles say
  const durations = cycles.duration_s.map((value) => value * means.factor);
  const expected = mean(durations);
  const bias = facts.check.doubted_bias;
  const spread = sorted(means.resampled.map((value, row) => value * (1 + means.error * tables.errors[row])));
  const wide = durations.map((value) => expected + facts.check.spread * (value - expected));
  const alone = tables.residuals ? wide.map((value, n) => value * (1 + tables.residuals[cycles.which[n]])) : durations;
  const lost = cycles.loss_s.reduce((sum, value) => sum + value, 0);
  const slower = lost > 0 ? Math.max(1 + ((means.factor - 1) * mean(cycles.duration_s)) / lost, 0) : 1;
  const nominal = legs.reduce((sum, leg) => sum + leg.nominal_s, 0);
  const [after, ofWork] = [beyondOf(cycles), widthOf(legs)];
  const less = ofWork[0] + after[0] * expected;
  const more = ofWork[1] + after[1] * expected + interludesIn_s({ robot: legs.map((leg) => leg.name.split("->")[1]) });
  const single = shifted(sorted(alone), less, more);
  const stands = cycles.stand_s.reduce((sum, value) => sum + value, 0);
  const stretch = stands > 0 ? (expected - nominal - lost * slower) / stands : 0;
  return {
    expected_s: expected,
    durations_s: [...durations],
    low_s: quantile(spread, 0.025) - bias * expected + less,
    high_s: quantile(spread, 0.975) + bias * expected + more,
    quantiles_s: [0.05, 0.5, 0.95].map((level) => quantile(single, level, true)),
    ofAll: legs.some((leg) => leg.ofAll),
    takt: takt_s > 0 ? leastWide([
      shareUpTo(single, takt_s),
      quantile(sharesOfDraws(alone, cycles.which, takt_s - more, bias, means.error), 0.025),
      quantile(sharesOfDraws(alone, cycles.which, takt_s - less, -bias, means.error), 0.975),
    ]) : null,
    safety_s: lost * slower,
    support: cycles.known / cycles.looked,
    tasks: legs.map((leg, n) => {
      const stand = cycles.stand_s[n] * stretch;
      const dwell = leg.dwell_s + leg.wait_s > 0 ? leg.dwell_s / (leg.dwell_s + leg.wait_s) : 1;
      const parts = [leg.nominal_s, cycles.loss_s[n] * slower, stand * dwell, stand * (1 - dwell)];
      return { name: leg.name, parts, logged: leg.logged };
    }),
  };
};

const leastWide = ([share, low, high]) => { // resample.least_wide: no narrower than Wilson's of so many executions
  const count = facts.executions || tables.drawn.length / tables.errors.length;
  const z = 1.96;
  const middle = (share + z ** 2 / (2 * count)) / (1 + z ** 2 / count);
  const half = (z * Math.sqrt((share * (1 - share)) / count + (z / (2 * count)) ** 2)) / (1 + z ** 2 / count);
  return [share, Math.max(Math.min(low, middle - half), 0), Math.min(Math.max(high, middle + half), 1)];
};

const rollerOfRobot = (legs, asked) => { // cycles_of: tracks as long as the slowest cycle takes; goes on when called again
  const nominal = legs.reduce((sum, leg) => sum + leg.nominal_s + leg.dwell_s + leg.wait_s, 0);
  const ramp = asked.ramp === null ? {} : { ramp_up_per_s: asked.ramp };
  const dynamics = { ...facts.dynamics, ...ramp };
  let horizon = 2.5 * nominal;
  let walker = null;
  return (deadline) => {
    field.moved(asked.moved);
    for (;;) {
      const samples = Math.min(SAMPLES, Math.ceil(horizon / STEP_S) + 2);
      if (!walker) {
        let crowd = null;
        if (asked.frequency !== 1) {
          const names = [...new Set(legs.map((leg) => leg.name))];
          const key = ["away", asked.moved, samples, names].join();
          crowd = asOften(asked.frequency, remembered(key, () => awayOf(names, samples)), samples);
          if (crowd.unknown) return crowd;
        }
        walker = walkerOf(legs, dynamics, crowd, samples);
      }
      const cycles = walker(deadline);
      if (cycles) return cycles;
      if (samples === SAMPLES) return { unknown: say("no_end") };
      [horizon, walker] = [2 * horizon, null];
    }
  };
};

const AS_LOGGED = () => ({ moved: facts.rule.moves.map(() => 0), ramp: null, frequency: 1 });
const isLogged = (asked) => asked.ramp === null && asked.frequency === 1 && asked.moved.every((by) => by === 0);

const answer = (places, asked, takt_s, deadline = Infinity) => {
  const names = namesOf(places);
  if (!names.length) return { unknown: say("no_visit") };
  const missing = [...new Set(names.filter((name) => !(name in facts.legs)))];
  if (missing.length) return { unknown: say("never_logged", { tasks: missing.map(shown).join(", ") }), missing };
  const legs = legsOf(places);
  const rolled = (how) => remembered([names.join(), how.moved.join(), how.ramp, how.frequency].join(";"), () => rollerOfRobot(legs, how))(deadline);
  const base = rolled(AS_LOGGED());
  if (base.unknown) return base;
  let [cycles, means] = [base, meansOf(base, legs)];
  if (!isLogged(asked)) {
    cycles = rolled(asked);
    if (cycles.unknown) return cycles;
    const factor = facts.check.factor * (means.moved || 1);
    const resampled = resampledMeans(cycles).map((value) => value * factor);
    means = { factor, resampled, error: modelError() };
  }
  const given = facts.sequences.find((each) => each.robot && each.robot.join() === places.join());
  const by = given && given.allowance ? given.allowance : 1; // TaskSequence.allowance
  means = { ...means, factor: means.factor * by, resampled: means.resampled.map((value) => value * by) };
  const walked = Math.min(base.walked, cycles.walked);
  const entry = entryOf(cycles, means, legs, takt_s);
  if (entry.support < 0.5) return { unknown: say("thin", { share: percent(entry.support) }), walked };
  return { ...entry, walked };
};
const labelled = (place) => facts.labels[place] || place;
const shown = (task) => task.split("->").map(labelled).join(" \u2192 ");

// ---- numbers as text, like `cyclekit.text.numbers`; no other part of the script rounds what people read

const fixed = (value, decimals = 1) => { // no minus before a zero
  const text = Math.abs(value).toFixed(decimals);
  return value < 0 && Number(text) ? `\u2212${text}` : text;
};
const shownApart = (value, other) => Number(value.toFixed(1)) - Number(other.toFixed(1)); // `difference`
const decimalsOf = (share) => (0 < share && share < 0.0995 ? 1 : 0);
const percent = (share, decimals = decimalsOf(share)) => { // only 0 shows as 0 %, and only 1 as 100 %
  const least = 10 ** -decimals;
  let text = fixed(100 * share, decimals);
  if (share < 1 && Number(text) === 100) text = `over ${fixed(100 - least, decimals)}`;
  if (share > 0 && Number(text) === 0) text = `under ${fixed(least, decimals)}`;
  return `${text}\u00a0%`;
};
const span = (low, high) => (fixed(low) === fixed(high) ? fixed(low) : `${fixed(low)} to ${fixed(high)}`);
const percentInterval = (low, high) => (percent(low) === percent(high)
  ? `\u00b1 under ${fixed(10 ** -decimalsOf(low), decimalsOf(low))}\u00a0%`
  : `${percent(low).replace("\u00a0%", "")} to ${percent(high)}`);
const interval = (low, high) => say(...(fixed(low) === fixed(high) // never two equal ends
  ? ["narrow", { value: fixed(0.1) }] : ["interval", { low: fixed(low), high: fixed(high) }]));
