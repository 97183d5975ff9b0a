// ---- the walk: `estimate.cycle.walk`, one track after the other

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

const FEWEST = 12; // tracks before anything is said
const spreadOut = (count) => { // the tracks, each far from the last: the first ones stand for all
  const divides = (a, b) => (b ? divides(b, a % b) : a);
  let by = Math.max(1, Math.round(count * 0.382));
  while (divides(by, count) > 1) by += 1;
  return Array.from({ length: count }, (_, n) => (n * by) % count);
};

const walkerOf = (legs, dynamics, crowd, samples) => { // walks until told to stop, goes on later
  const { step } = facts;
  const follows = facts.follows || Object.values(dynamics).some((value) => value);
  const step_s = follows ? step.fine_s : step.coarse_s;
  const asksAfter = facts.often ? 1 : Math.round(step.coarse_s / step_s); // a network is asked more seldom
  const looksAfter = Math.round(step.support_s / step_s);
  const steps = Math.floor(((samples - 2) * STEP_S) / step_s);
  const count = legs.length;
  const times = {};
  let begins_s = 0;
  const parts = legs.map((leg) => {
    const usual_s = leg.dwell_s + leg.wait_s;
    times[leg.name] = (times[leg.name] || 0) + 1;
    const part = { ...leg, usual_s, begins_s, drawn: COUNT * (leg.stands + times[leg.name] - 1) };
    begins_s += leg.nominal_s + usual_s;
    return part;
  });
  const cells = Math.max(1, Math.round(begins_s / step.nominal_s)); // Program.xyz_m: the TCP in the middle of cells
  const cell_s = begins_s / cells;
  const order = spreadOut(COUNT);
  const found = Object.fromEntries(["duration_s", "lost_s", "ownBase_s", "ownLoss_s"].map((name) => [name, new Float64Array(COUNT)]));
  const sums = { loss_s: new Float64Array(count), stand_s: new Float64Array(count) };
  let [known, looked, walked] = [0, 0, 0];
  const one = (k) => {
    const logged = crowd ? crowd.logged[k] : facts.tracks.logged[k];
    let leg = 0;
    let moving = true;
    let at = 0; // of the motion, nominal; of the stand, elapsed
    let scaling = 1;
    const follow = follows ? followerOf(dynamics, step_s, facts.tracks.scaling && facts.tracks.scaling[k]) : null;
    let asked; // at which sample
    let spliced = 0;
    let ownLoss = 0;
    let lost = 0;
    let end_s = NaN;
    for (let number = 0; number < steps; number += 1) {
      const part = parts[leg];
      const stand = part.usual_s > 0 ? tables.stands[part.drawn + k] : 0;
      const asksNow = number % asksAfter === 0;
      const t = ((number + (asksNow ? asksAfter / 2 : 0.5)) * step_s) / STEP_S;
      const sample = asksNow ? Math.floor(t + NOTHING) : asked;
      const looks = number % looksAfter === 0;
      const asks = asksNow && (follows || moving || stand - at < step_s);
      asked = sample;
      if (asks || looks) {
        const place = moving ? Math.min(at + (scaling * asksAfter * step_s) / 2, part.nominal_s) : part.nominal_s;
        const middle = (Math.min(Math.floor((part.begins_s + place) / cell_s), cells - 1) + 0.5) * cell_s - part.begins_s;
        const share = moving ? Math.min(Math.max(middle / Math.max(part.nominal_s, NOTHING), 0), 1) : 1;
        const phase = share * (part.points - 1);
        const point = Math.min(Math.floor(phase), part.points - 1);
        const next = Math.min(point + 1, part.points - 1);
        const first = k * samples;
        const from = k * SAMPLES + (crowd ? crowd.at[first + sample] : sample);
        const to = k * SAMPLES + (crowd ? crowd.at[first + sample + 1] : sample + 1);
        const weight = t - sample < 1e-6 ? 0 : t - sample;
        field.at(part.first + point, part.first + next, phase - point, from, to, weight);
        if (looks) {
          looked += 1;
          if (field.known()) known += 1;
        }
      }
      if (follows) {
        scaling = follow(asksNow);
      } else {
        scaling = asks ? field.scaling(false) : 1;
      }
      let left = step_s;
      let loss = 0;
      for (;;) { // a step is divided where a motion or a stand ends in it
        const now = parts[leg];
        const goal = moving ? now.nominal_s : (now.usual_s > 0 ? tables.stands[now.drawn + k] : 0);
        const rate = moving ? scaling : 1;
        const needs = goal - at <= NOTHING ? 0 : (goal - at) / Math.max(rate, 1e-12);
        const spent = Math.min(needs, left);
        if (moving) {
          loss += (1 - rate) * spent;
          sums.loss_s[leg] += (1 - rate) * spent;
        } else sums.stand_s[leg] += spent;
        left -= spent;
        if (needs > left + spent) { at += rate * spent; break; }
        at = 0;
        if (!moving) leg += 1;
        moving = !moving;
        if (leg === count) break;
      }
      lost += loss;
      if (sample < logged) ownLoss += loss;
      else spliced += step_s;
      if (leg === count) { end_s = (number + 1) * step_s - left; break; }
    }
    if (Number.isNaN(end_s)) return false;
    found.duration_s[k] = end_s;
    found.lost_s[k] = lost;
    found.ownLoss_s[k] = ownLoss;
    found.ownBase_s[k] = Math.max(end_s - spliced - ownLoss, 0);
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
