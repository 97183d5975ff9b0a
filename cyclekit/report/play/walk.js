// ---- one cycle of the robot: `estimate.cycle.engine`

const followerOf = (dynamics, step_s, start) => { // Follower: s of one cycle over time
  const { latency_s: latency, hold_s: holds, ramp_down_per_s: down, ramp_up_per_s: up } = dynamics;
  const delay = halfToEven((latency || 0) / step_s);
  const hold = 1 + halfToEven((holds || 0) / step_s);
  const [recent, queue] = [new Float64Array(hold).fill(Infinity), new Float64Array(delay)];
  const { lags } = facts.rule;
  let step = 0;
  let held, s, told;
  return (asks) => {
    if (asks) {
      told = field.scaling(false);
      if (lags) {
        const rising = field.scaling(true);
        told = Math.max(told, rising);
        held = held === undefined ? told : Math.min(Math.max(held, rising), told);
        told = held;
      }
    }
    let wanted = told;
    if (hold > 1) {
      recent[step % hold] = wanted;
      for (let n = 0; n < hold; n += 1) if (recent[n] < wanted) wanted = recent[n];
    }
    if (delay > 0) {
      const late = step < delay ? (step ? queue[0] : wanted) : queue[step % delay];
      queue[step % delay] = wanted;
      wanted = late;
    }
    step += 1;
    if (wanted === s) return s;
    if (s === undefined) s = typeof start === "number" ? Math.min(start, wanted) : wanted;
    if (down && wanted < s - down * step_s) wanted = s - down * step_s;
    if (up && wanted > s + up * step_s) wanted = s + up * step_s;
    const rate = (wanted < s ? down : up) || Infinity;
    const mean = wanted + ((s - wanted) * Math.abs(wanted - s)) / rate / (2 * step_s);
    s = wanted;
    return mean;
  };
};

const [MOVES, WORKS, WAITS, ENDED] = [0, 1, 2, 3];
const walkRobot = (rows, person, { dynamics, start, coarse, waits, until_s, known_s }) => { // to its end; null: it does not end
  const { step } = facts;
  const follows = facts.follows || Object.values(dynamics).some((value) => value);
  const step_s = follows || !coarse ? step.fine_s : step.coarse_s;
  const asksAfter = facts.often ? 1 : Math.round(step.coarse_s / step_s); // a network is asked more seldom
  const looksAfter = Math.round(step.support_s / step_s);
  const follow = follows ? followerOf(dynamics, step_s, start) : null;
  const human = { from: 0, to: 0, weight: 0 };
  const ahead_s = (asksAfter * step_s) / 2;
  const steps = Math.trunc(until_s / step_s + NOTHING) - (waits ? 0 : asksAfter - 1);
  const found = { known: 0, looked: 0, stuck: false, ownLoss_s: 0 };
  let [leg, part, at, clock, scaling, end] = [0, MOVES, 0, 0, 1, rows[0].way_s];
  const look = (number) => {
    const { low, high, first } = rows[leg].path;
    const gone = part === MOVES ? Math.min(at + ahead_s * scaling, end) / Math.max(end, NOTHING) : 1;
    const row = first + low + Math.floor(gone * (high - low) + 0.5);
    person(number * step_s + ahead_s, human);
    field.at(row, human.from, human.to, human.weight);
    if (number % looksAfter !== 0) return;
    found.looked += 1;
    if (field.known()) found.known += 1;
  };
  const next = () => { // what follows on a way, its own work or a wait
    const row = rows[leg];
    at = 0;
    if (part === MOVES) {
      row.arrives_s = clock;
      if (waits) waits.arrived(row, clock);
      [part, end] = [WORKS, row.own_s];
      return;
    }
    if (part === WORKS) {
      row.works_s = clock;
      part = WAITS;
      if (waits) return;
    }
    row.passes_s = clock;
    if (waits) waits.departed(row, clock);
    if (leg === rows.length - 1) part = ENDED;
    else { leg += 1; [part, end] = [MOVES, rows[leg].way_s]; }
  };
  const advance = (until, own) => { // to a time; returns whether a new part began
    let touched = false;
    while (part !== ENDED) {
      const rate = part === MOVES ? scaling : 1;
      const toGo = end - at;
      let takes = toGo <= NOTHING ? 0 : toGo / Math.max(rate, 1e-12);
      if (part === WAITS) takes = waits.opensAt(rows[leg], clock) - clock;
      const left = until - clock;
      const done = takes <= left;
      if (part === WAITS) {
        if (done) clock += takes;
      } else {
        const spent = Math.min(takes, left);
        clock += spent;
        at += rate * spent;
        if (part === MOVES) {
          rows[leg].lost_s += (1 - rate) * spent;
          if (own) found.ownLoss_s += (1 - rate) * spent;
        }
      }
      if (!done) break;
      touched = true;
      next();
    }
    return touched;
  };
  if (waits) waits.settle();
  let t_s = 0; // of the last question
  for (let number = 0; number < steps; number += 1) {
    const asks = number % asksAfter === 0;
    const mayMove = part === MOVES || part === WAITS || end - at < step_s;
    if (asks) t_s = number * step_s + ahead_s;
    if (asks && (follows || mayMove || number % looksAfter === 0)) look(number);
    if (follow) scaling = follow(asks);
    else if (asks) scaling = mayMove ? field.scaling(false) : 1;
    if (advance((number + 1) * step_s, !(t_s >= known_s)) && waits) waits.settle();
    if (part === ENDED) return found;
    let soon = number + 1;
    if (part === WAITS) {
      const open_s = waits.opensAt(rows[leg], 0);
      found.stuck = open_s === Infinity;
      if (found.stuck) return found;
      soon = Math.floor(open_s / step_s) - asksAfter;
    } else if (part === WORKS) soon = Math.floor((clock + end - at) / step_s) - asksAfter;
    if (follow || soon <= number + 1) continue; // nothing hangs on s meanwhile: go on to where the robot moves again
    soon = Math.min(soon, steps - 1);
    for (let each = number + 1; each < soon; each += 1) if (each % asksAfter === 0 && each % looksAfter === 0) look(each);
    if (part === WORKS) {
      at += soon * step_s - clock;
      clock = soon * step_s;
    }
    number = soon - 1;
  }
  return found;
};

// ---- the robot beside every track: `estimate.cycle.walk`, one after the other

const FEWEST = 12; // tracks before anything is said
const spreadOut = (count) => { // the tracks, each far from the last: the first ones stand for all
  const divides = (a, b) => (b ? divides(b, a % b) : a);
  let by = Math.max(1, Math.round(count * 0.382));
  while (divides(by, count) > 1) by += 1;
  return Array.from({ length: count }, (_, n) => (n * by) % count);
};

const walkerOf = (legs, dynamics, crowd, samples) => { // walks until told to stop, goes on later
  const count = legs.length;
  const times = {};
  const rows = legs.map((leg) => {
    times[leg.name] = (times[leg.name] || 0) + 1;
    const path = { first: leg.first, low: 0, high: leg.points - 1 };
    return { path, way_s: leg.nominal_s, own_s: 0, lost_s: 0, drawn: COUNT * (leg.stands + times[leg.name] - 1) };
  });
  const order = spreadOut(COUNT);
  const found = Object.fromEntries(["duration_s", "lost_s", "ownBase_s", "ownLoss_s"].map((name) => [name, new Float64Array(COUNT)]));
  const sums = { loss_s: new Float64Array(count), stand_s: new Float64Array(count) };
  let [known, looked, walked] = [0, 0, 0];
  const one = (k) => {
    const known_s = STEP_S * (crowd ? crowd.logged[k] : facts.tracks.logged[k]);
    for (const row of rows) [row.own_s, row.lost_s, row.passes_s] = [tables.stands[row.drawn + k], 0, Infinity];
    const person = (t_s, human) => {
      const t = t_s / STEP_S;
      const sample = Math.floor(t + NOTHING);
      human.from = k * SAMPLES + (crowd ? crowd.at[k * samples + sample] : sample);
      human.to = k * SAMPLES + (crowd ? crowd.at[k * samples + sample + 1] : sample + 1);
      human.weight = t - sample < 1e-6 ? 0 : t - sample;
    };
    const start = facts.tracks.scaling && facts.tracks.scaling[k];
    const cycle = walkRobot(rows, person, { dynamics, start, coarse: true, until_s: (samples - 2) * STEP_S, known_s });
    const end_s = rows[count - 1].passes_s;
    if (end_s === Infinity) return false;
    known += cycle.known;
    looked += cycle.looked;
    rows.forEach((row, n) => { sums.loss_s[n] += row.lost_s; sums.stand_s[n] += row.own_s; found.lost_s[k] += row.lost_s; });
    found.duration_s[k] = end_s;
    found.ownLoss_s[k] = cycle.ownLoss_s;
    found.ownBase_s[k] = Math.max(Math.min(end_s, known_s) - cycle.ownLoss_s, 0);
    return true;
  };
  const summed = () => { // the cycles so far, in the order of their tracks
    const which = order.slice(0, walked).sort((a, b) => a - b);
    const some = Object.entries(found).map(([name, values]) => [name, walked === COUNT ? values : Float64Array.from(which, (k) => values[k])]);
    const means = Object.entries(sums).map(([name, values]) => [name, values.map((value) => value / walked)]);
    return { ...Object.fromEntries([...some, ...means]), which, known, looked, walked };
  };
  return (deadline) => { // null: a cycle does not end on its track
    const least = walked + FEWEST; // it goes on each time, however late it is
    while (walked < COUNT && (walked < least || performance.now() < deadline)) {
      if (!one(order[walked])) return null;
      walked += 1;
    }
    return summed();
  };
};
