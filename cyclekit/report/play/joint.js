// ---- plans for both agents, and places of the robot beside operators who wait: `joint.roll`, `joint.answer`

const fittingOrders = (places) => { // Planner._fitting: what operators did while the robot did the same work
  const counted = (went, only) => went.slice(1).filter((place) => !only || only.includes(place)).sort().join("\n");
  for (const only of [null, facts.waited_for]) {
    const mine = counted(places, only);
    const found = facts.went.filter((each) => counted(each.robot, only) === mine);
    if (found.length) return found.map((each) => each.operator);
  }
  return [];
};

const AT_LEAST = 100; // cycles before anything is said
const rollerOf = (places, operators, both, asked, told) => { // JointCell.roll: walks until told to stop, goes on later
  const robot = robotAgenda(places, asked, told && told.robot);
  const agendas = new Map(operators.map((order) => [order.join("\n"), operatorAgenda(order, asked, told && told.operator, !both)]));
  const sources = facts.sources.map((source) => sourceAgenda(source, robot, asked)).filter(Boolean);
  const numbers = new Map();
  const number = (event) => numbers.get(event) ?? numbers.set(event, numbers.size).get(event);
  const [mine, ...parts] = [robot, ...sources].map((agenda) => rowsOf(drawnOf(agenda, number)));
  const theirs = operators.map((order) => order.join("\n"));
  const theirRows = new Map([...agendas].map(([name, agenda]) => [name, rowsOf(drawnOf(agenda, number))]));
  const first = agendas.get(theirs[0]);
  const work_s = [robot, first].flatMap((agenda) => agenda.legs)
    .reduce((sum, leg) => sum + Math.max(...leg.own_s, 0) + leg.way_s + 5, 0);
  const latest_s = Math.max(...[robot, first].flatMap((agenda) => agenda.legs).map((leg) => leg.notBefore_s));
  const until_s = facts.rest_s + facts.times * work_s + latest_s;
  const events = new Float64Array(numbers.size);
  const beginOf = (rows) => {
    const begins = rows.findIndex(({ leg }) => leg.task >= 0 && !leg.hold);
    return begins > 0 ? rows[begins - 1].passes_s : Infinity;
  };
  const endOf = (rows) => rows[rows.length - 1].passes_s;
  const one = (cycle) => {
    events.fill(-Infinity);
    const operator = theirRows.get(theirs[cycle % theirs.length]);
    for (const rows of [mine, operator, ...parts]) drawInto(rows, cycle, events, asked);
    const walked = walkBoth(mine, operator, parts, events, asked, until_s);
    const begins_s = Math.min(beginOf(mine), beginOf(operator));
    const begin_s = begins_s === Infinity ? 0 : begins_s;
    const duration_s = both ? Math.max(endOf(mine), endOf(operator)) - begin_s : endOf(mine);
    note(log.robot, mine, cycle);
    if (log.operator) note(log.operator, operator, cycle);
    return { ...walked, cycle, begin_s, duration_s };
  };
  const alone = agendas.size === 1; // the same tasks in all cycles
  let log = { robot: logOf(robot), operator: alone ? logOf(first) : null };
  let cycles = [];
  let entry = null;
  return (deadline) => {
    field.moved(asked.moved);
    while (cycles.length < facts.cycles && !entry && (performance.now() < deadline || cycles.length < AT_LEAST)) {
      cycles.push(one(cycles.length));
    }
    if (entry) return entry;
    const found = summedUp(cycles, log, robot.tasks, alone ? first.tasks : null, both);
    if (cycles.length === facts.cycles) [entry, cycles, log] = [found, [], null];
    return found;
  };
};
const TIMES_S = ["arrives_s", "works_s", "passes_s", "lost_s"];
const logOf = (agenda) => agenda.legs.map((leg) => ({ // times of each leg in each cycle
  leg, ...Object.fromEntries(TIMES_S.map((name) => [name, new Float64Array(facts.cycles)])),
}));
const note = (log, rows, cycle) => {
  for (let n = 0; n < log.length; n += 1) {
    const [times, row] = [log[n], rows[n]];
    times.arrives_s[cycle] = row.arrives_s;
    times.works_s[cycle] = row.works_s;
    times.passes_s[cycle] = row.passes_s;
    times.lost_s[cycle] = row.lost_s;
  }
};
const summedUp = (all, log, robot, operator, both) => {
  const going = all.filter((each) => !each.stuck);
  if (going.length < (1 - facts.left_out) * all.length) return { unknown: say("stuck") };
  const cycles = going.filter((each) => each.duration_s < Infinity);
  if (cycles.length < (1 - facts.left_out) * going.length) return { unknown: say("endless") };
  return { ...entryOfBoth({ cycles, log, robot, operator, both }), walked: all.length };
};

const spansOf = (cycles, log, who, tasks, tell, cut = false) => { // shares._spans: start, end and wait of each task
  const last = log.length - 1;
  let [before, task] = [0, -1];
  const found = [];
  log.forEach(({ leg, works_s, passes_s }, n) => {
    if (leg.task < 0 || leg.hold) return;
    const at = (choose) => {
      const found_s = new Float64Array(cycles.length);
      for (let k = 0; k < found_s.length; k += 1) found_s[k] = choose(cycles[k].cycle, cycles[k].begin_s);
      return found_s;
    };
    const [departs_s, done_s, ready_s] = [log[n - 1].passes_s, n === last ? passes_s : works_s, log[before].works_s];
    let start_s = at((cycle, begin_s) => departs_s[cycle] - begin_s);
    let end_s = at((cycle, begin_s) => done_s[cycle] - begin_s);
    let wait_s = at((cycle, begin_s) => Math.max(departs_s[cycle] - Math.max(ready_s[cycle], begin_s), 0));
    const rest = leg.task === task; // of a task on whose way the robot may wait
    [before, task] = [n, leg.task];
    if (cut) { // shares._in_cycle: at the ends of the cycles
      if (2 * start_s.filter((value, k) => value < cycles[k].duration_s).length < cycles.length) return;
      const till = (values) => values.map((value, k) => Math.min(value, cycles[k].duration_s));
      wait_s = till(start_s).map((value, k) => Math.max(value - (start_s[k] - wait_s[k]), 0));
      [start_s, end_s] = [till(start_s), till(end_s)];
    }
    if (rest && found.length && mean(wait_s) < facts.midway_s) { // shares._joined
      found[found.length - 1].end_s = end_s;
    } else {
      found.push({ task: leg.task, start_s, end_s, wait_s });
    }
  });
  return found.map((span) => ({ agent: who, name: tasks[span.task], task: span.task, ...tell(span.start_s, span.end_s, span.wait_s) }));
};

const sharesOf = (cycles, log, factor) => { // shares.task_shares, as `answer._slowed` corrects them
  const found = [];
  const meanOf = (choose) => cycles.reduce((sum, { cycle }) => sum + choose(cycle), 0) / cycles.length;
  log.forEach(({ leg, arrives_s, works_s, passes_s, lost_s }) => {
    if (leg.task < 0) return;
    const share = found[leg.task] || { nominal_s: 0, lost_s: 0, dwell_s: 0, wait_s: 0 };
    found[leg.task] = share;
    share.nominal_s += leg.way_s;
    share.lost_s += meanOf((cycle) => lost_s[cycle]);
    share.dwell_s += meanOf((cycle) => works_s[cycle] - arrives_s[cycle]);
    share.wait_s += meanOf((cycle) => passes_s[cycle] - works_s[cycle]);
  });
  const sum = (part) => found.reduce((all, share) => all + part(share), 0);
  const open_s = sum((share) => share.lost_s + share.wait_s);
  const more_s = (factor - 1) * sum((share) => share.nominal_s + share.lost_s + share.dwell_s + share.wait_s);
  const times = open_s > 0 ? Math.max(1 + more_s / open_s, 0) : 1;
  return found.map((share) => ({ ...share, lost_s: share.lost_s * times, wait_s: share.wait_s * times }));
};

const spreadOf = (values) => Math.sqrt(covariance(values, values));
const singleOfBoth = (values) => { // JointCheck.single
  const [middle, ordered] = [mean(values), sorted(values)];
  const [scores, ranks] = [tables.scores, tables.ranks].map((some) => some && sorted(some));
  const spread = scores ? Math.max(spreadOf(values), facts.check.least_spread * middle) : 0;
  return shiftedOf(values, ordered.map((_, n) => {
    const level = (n + 1) / (ordered.length + 1);
    if (scores) return middle + quantile(scores, level, true) * spread;
    return middle + facts.check.widening * (quantile(ordered, ranks ? quantile(ranks, level, true) : level) - middle);
  }));
};
const bandOf = (single, levels) => {
  const ordered = sorted(single);
  return levels.map((level) => quantile(ordered, level, true));
};
const fewDrawn = () => { // of each row of `drawn`, which is nearly empty: the cycles that were drawn
  const [first, which] = [[0], []];
  for (let row = 0; row < tables.errors.length; row += 1) {
    for (let n = 0; n < facts.cycles; n += 1) if (tables.drawn[row * facts.cycles + n]) which.push(n);
    first.push(which.length);
  }
  return { first, which: Int32Array.from(which) };
};
const inDraws = (values, shared) => { // as finite logs give them, drawn again; `shared` in each cycle, if sessions differ
  tables.few = tables.few || fewDrawn();
  const { first, which } = tables.few;
  const { shifts } = tables;
  const slope = shared ? (covariance(values, shared) * (values.length - 1)) / values.length : 0; // answer.with_sessions
  return Float64Array.from(tables.errors, (_, row) => {
    let [sum, count] = [0, 0];
    for (let at = first[row]; at < first[row + 1]; at += 1) {
      const drawn = tables.drawn[row * facts.cycles + which[at]];
      sum += drawn * values[which[at]];
      count += drawn;
    }
    return sum / count + (slope && slope * shifts[row]);
  });
};

const entryOfBoth = ({ cycles, log, robot, operator, both }) => { // JointAnswers._entry
  const { factor, model_error: error, doubted_bias: bias } = facts.check;
  const durations = Float64Array.from({ length: facts.cycles }, (_, n) => cycles[n % cycles.length].duration_s * factor);
  const scores = tables.shifts && sharedOf();
  const shared = scores && durations.map((_, n) => scores[cycles[n % cycles.length].cycle]);
  const [expected, single, more] = [mean(durations), singleOfBoth(durations), interludesIn_s({ robot: robot.map((name) => name.split("->").pop()) })];
  const spread = sorted(inDraws(durations, shared).map((value, row) => value * (1 + error * tables.errors[row])));
  const tell = (start_s, end_s, wait_s) => ({
    start_s: factor * mean(start_s), end_s: factor * mean(end_s), wait_s: factor * mean(wait_s),
    ends_s: bandOf(singleOfBoth(end_s.map((value) => value * factor)), [0.05, 0.95]),
  });
  const shares = sharesOf(cycles, log.robot, factor);
  const mine = spansOf(cycles, log.robot, "robot", robot, tell);
  const theirs = operator ? spansOf(cycles, log.operator, "operator", operator, tell, !both) : [];
  const [knownLooks, looks] = ["known", "looked"].map((part) => cycles.reduce((sum, each) => sum + each[part], 0));
  return {
    expected_s: expected,
    durations_s: durations,
    single,
    more,
    shared,
    low_s: quantile(spread, 0.025) - bias * expected,
    high_s: quantile(spread, 0.975) + bias * expected + more,
    quantiles_s: [0.05, 0.5, 0.95].map((level) => quantile(shifted(sorted(single), 0, more), level, true)),
    safety_s: shares.reduce((sum, share) => sum + share.lost_s, 0),
    support: looks ? knownLooks / looks : null,
    tasks: [...mine.map((span) => ({ ...span, share: shares[span.task] })), ...theirs],
  };
};

const TAKTS = new WeakMap(); // of each answer, the last takt and the share within it
const withinOfBoth = (entry, takt_s) => {
  const [known, found] = TAKTS.get(entry) || [];
  if (known === takt_s) return found;
  const within = sharesWithin(entry, takt_s);
  TAKTS.set(entry, [takt_s, within]);
  return within;
};
const sharesWithin = ({ single: durations, shared, more }, takt_s) => {
  const { doubted_bias: bias, model_error: error } = facts.check;
  const { first, which } = tables.few; // set for the interval of the mean
  const order = Array.from(durations.keys()).sort((a, b) => durations[a] - durations[b]);
  const middle = shared ? mean(shared) : 0;
  const slope = [0]; // of the share with what durations share, up to each cycle: answer.with_sessions
  if (shared) order.forEach((n, at) => slope.push(slope[at] + (shared[n] - middle) / durations.length));
  const lengths = order.map((n) => durations[n]);
  const drawn = (by, within_s) => sorted(Float64Array.from(tables.errors, (off, row) => {
    const longest = within_s / ((1 + by) * Math.max(1 + error * off, 1e-9));
    let [sum, count] = [0, 0];
    for (let at = first[row]; at < first[row + 1]; at += 1) {
      const times = tables.drawn[row * facts.cycles + which[at]];
      if (durations[which[at]] <= longest) sum += times;
      count += times;
    }
    return sum / count + (shared ? tables.shifts[row] * slope[upTo(lengths, longest)] : 0);
  }));
  const bounds = [quantile(drawn(bias, takt_s - more), 0.025), quantile(drawn(-bias, takt_s), 0.975)];
  return leastWide([shareUpTo(shifted(lengths, 0, more), takt_s), ...bounds]);
};

const answerBoth = (asked_for, asked, takt_s, deadline = Infinity) => {
  const { robot: places, operator, both } = asked_for;
  if (places.length < 2) return { unknown: say("no_visit") };
  const legs = places.slice(1).map((place, n) => `${places[n]}->${place}`);
  const missing = [...new Set(legs.filter((name) => !(name in facts.legs)))];
  if (missing.length) return { unknown: say("never_logged", { tasks: missing.map(shown).join(", ") }), missing };
  const told = asked_for.asked ? askedOf(places, asked_for.asked) : null;
  if (told && told.missing.length) return { unknown: say("left_out", { tasks: told.missing.map(shown).join(", ") }) };
  const operators = operator ? [operator] : fittingOrders(places);
  if (!operators.length) return { unknown: say("no_operator") };
  const roll = remembered(JSON.stringify(["both", asked_for, asked]), () => rollerOf(places, operators, both, asked, told));
  const entry = roll(deadline);
  if (entry.unknown) return entry;
  if (entry.support !== null && entry.support < 0.5) return { unknown: say("thin", { share: percent(entry.support) }) };
  return { ...entry, takt: takt_s > 0 ? withinOfBoth(entry, takt_s) : null };
};
