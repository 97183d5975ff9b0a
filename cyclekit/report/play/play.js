"use strict";
// Plays with the sequences of the page. Optional: without it the page is complete, and this section stays hidden.
// The steps are those of cyclekit's `estimate`: the names say which function each part follows.
(() => {
  const holder = document.getElementById("play-data");
  if (!holder || typeof DecompressionStream === "undefined") return;
  const told = JSON.parse(holder.textContent);
  const facts = told.facts;
  const words = facts.words;
  const say = (key, values = {}) => words[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
  const UNKNOWN = -32768;
  const NOBODY = 65535;
  const NOTHING = 1e-9;

  // ---- the tables

  const TYPES = {
    uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array, float32: Float32Array,
  };
  const tables = {};

  const unpack = async () => {
    const zipped = Uint8Array.from(atob(told.block), (letter) => letter.charCodeAt(0));
    const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("deflate"));
    const block = await new Response(stream).arrayBuffer();
    for (const [name, [type, offset, count]] of Object.entries(told.arrays)) {
      tables[name] = new TYPES[type](block, offset, count);
    }
    told.block = "";
  };

  const summed = (array, from, count) => { // steps become values again; both wrap
    for (let at = from + 3; at < from + 3 * count; at += 1) array[at] += array[at - 3];
  };
  const metres = (array) => Float64Array.from(array, (units) => (units === UNKNOWN ? NaN : units / facts.per_metre));

  let COUNT, SAMPLES, STEP_S, people, paths;
  const prepare = () => {
    COUNT = facts.tracks.count;
    SAMPLES = tables.tracks.length / 3 / COUNT;
    STEP_S = facts.tracks.step_s;
    for (let k = 0; k < COUNT; k += 1) summed(tables.tracks, 3 * k * SAMPLES, SAMPLES);
    summed(tables.paths, 0, tables.paths.length / 3);
    people = metres(tables.tracks);
    paths = metres(tables.paths);
  };

  // ---- the safety function: `RuleSafety.predict` with the limits that were moved

  const TO_TCP = "distance TCP to operator";
  const TO_TCP_FLAT = "distance TCP to operator on the floor";
  const within = (rectangle, out, x, y) => {
    const cos = Math.cos(rectangle.angle_rad || 0);
    const sin = Math.sin(rectangle.angle_rad || 0);
    const along = x * cos + y * sin;
    const across = y * cos - x * sin;
    const bound = (edge, side, axis) => (edge === null ? side * Infinity : edge.value + side * out[axis]);
    return along > bound(rectangle.along[0], -1, 0) && along < bound(rectangle.along[1], 1, 0)
      && across > bound(rectangle.across[0], -1, 1) && across < bound(rectangle.across[1], 1, 1);
  };
  const STAYS = [0, 0];

  const apart = (name, r, h) => { // r: TCP, h: operator, his height that of the TCP where it is unknown
    if (name === TO_TCP) return Math.hypot(r[0] - h[0], r[1] - h[1], r[2] - h[2]);
    return name === TO_TCP_FLAT ? Math.hypot(r[0] - h[0], r[1] - h[1]) : Math.hypot(h[0], h[1]);
  };

  const inside = (region, move, r, h) => {
    const there = !region.robot || within(region.robot, STAYS, r[0], r[1]);
    if (!there) return false;
    const asks = region.anywhere || region.nearer.length || region.rectangles.length || region.polygons.length;
    if (!asks) return Boolean(region.robot);
    if (Number.isNaN(h[0])) return false;
    return region.anywhere
      || region.nearer.some((near) => apart(near.distance, r, h) < near.metres.value + move.threshold_m)
      || region.rectangles.some((rectangle) => within(rectangle, move.zone, h[0], h[1]))
      || region.polygons.some((polygon) => polygon.sides.every(
        (side) => h[0] * Math.cos(side.angle_rad) + h[1] * Math.sin(side.angle_rad) < side.metres.value));
  };

  const filled = (region) => region && {
    anywhere: false, nearer: [], rectangles: [], polygons: [], robot: null, ...region,
  };
  const safetyOf = (moved) => { // moved: by how much each of `rule.moves` is moved
    const rule = facts.rule;
    const limits = rule.limits.map((limit) => {
      const move = { threshold_m: 0, zone: [0, 0] };
      rule.moves.forEach((each, index) => {
        if (each.level !== limit.scaling) return;
        if (each.kind === "zone") for (const axis of each.axes) move.zone[axis] = moved[index];
        else move.threshold_m = moved[index];
      });
      return { scaling: limit.scaling, move, within: filled(limit.within), until: filled(limit.until) || filled(limit.within) };
    });
    const simple = limits.every(({ within: one }) => one.nearer.length === 1 && one.nearer[0].distance === TO_TCP
      && !one.anywhere && !one.rectangles.length && !one.polygons.length && !one.robot) && !rule.lags && !rule.law;
    const square = limits.map((one) => (simple ? (one.within.nearer[0].metres.value + one.move.threshold_m) : 0));
    const lawful = (r, h) => {
      const { stop, linear, square: squared, lowest, distance } = rule.law;
      const left = Math.max(apart(distance, r, h) - stop.value, 0);
      const root = Math.sqrt(linear.value ** 2 + 4 * squared.value * left);
      return Math.min(1, Math.max(lowest || 0, (2 * left) / Math.max(linear.value + root, 1e-12)));
    };
    return (r, h, leaving) => {
      if (Number.isNaN(h[0]) && !rule.slows_alone) return rule.alone;
      if (simple) {
        const x = r[0] - h[0];
        const y = r[1] - h[1];
        const z = r[2] - h[2];
        const away = Math.sqrt(x * x + y * y + z * z);
        for (let n = 0; n < limits.length; n += 1) if (away < square[n]) return limits[n].scaling;
        return rule.fastest;
      }
      if (rule.law) return lawful(r, h);
      for (const limit of limits) {
        if (inside(leaving ? limit.until : limit.within, limit.move, r, h)) return limit.scaling;
      }
      return rule.fastest;
    };
  };

  // ---- the operator comes more or less often: `whatif.alter._as_often`

  const kept = new Map();
  const remembered = (key, make) => {
    if (!kept.has(key)) {
      if (kept.size > 20) kept.clear();
      kept.set(key, make());
    }
    return kept.get(key);
  };

  const awayOf = (legs, safety, samples) => {
    const names = [...new Set(legs)].map((name) => facts.legs[name]);
    const total = names.reduce((sum, leg) => sum + leg.points, 0);
    const count = Math.min(facts.away.points, total);
    const points = [];
    for (let n = 0; n < count; n += 1) {
      let at = Math.floor(count > 1 ? (n * (total - 1)) / (count - 1) : 0);
      let leg = 0;
      while (at >= names[leg].points) { at -= names[leg].points; leg += 1; }
      const from = 3 * (names[leg].first + at);
      points.push([paths[from], paths[from + 1], paths[from + 2]]);
    }
    const best = facts.away.part * facts.rule.fastest;
    const free = Array.from({ length: tables.spots.length / 3 }, (_, spot) => points.every((r) => {
      const h = [...tables.spots.subarray(3 * spot, 3 * spot + 3)];
      if (Number.isNaN(h[2])) h[2] = r[2];
      const s = facts.rule.lags ? (safety(r, h, false) + safety(r, h, true)) / 2 : safety(r, h, false);
      return s >= best;
    }));
    const found = new Uint8Array(COUNT * samples);
    for (let k = 0; k < COUNT; k += 1) {
      for (let i = 0; i < samples; i += 1) {
        const spot = tables.people_spots[k * SAMPLES + i];
        found[k * samples + i] = spot === NOBODY || free[spot] ? 1 : 0;
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
      return { unknown: say("too_often", { most: (1 / Math.max(1 - share, NOTHING)).toFixed(2) }) };
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

  // ---- the walk: `estimate.walk`, one track after the other

  const walk = (legs, safety, dynamics, crowd, samples) => {
    const { rule, step } = facts;
    const down = dynamics.ramp_down_per_s;
    const up = dynamics.ramp_up_per_s;
    const follows = rule.lags || Object.values(dynamics).some((value) => value);
    const step_s = follows ? step.fine_s : step.coarse_s;
    const looksAfter = Math.round(step.support_s / step_s);
    const delay = Math.round((dynamics.latency_s || 0) / step_s);
    const hold = 1 + Math.round((dynamics.hold_s || 0) / step_s);
    const steps = Math.floor(((samples - 2) * STEP_S) / step_s);
    const count = legs.length;
    const times = {};
    let begins_s = 0;
    const parts = legs.map((name) => {
      const leg = facts.legs[name];
      const usual_s = leg.dwell_s + leg.wait_s;
      times[name] = (times[name] || 0) + 1;
      const part = { ...leg, usual_s, begins_s, drawn: COUNT * (leg.stands + times[name] - 1) };
      begins_s += leg.nominal_s + usual_s;
      return part;
    });
    const cells = Math.max(1, Math.round(begins_s / step.nominal_s)); // Program.xyz_m: the TCP in the middle of cells
    const cell_s = begins_s / cells;
    const found = {
      duration_s: new Float64Array(COUNT), lost_s: new Float64Array(COUNT), ownBase_s: new Float64Array(COUNT),
      ownLoss_s: new Float64Array(COUNT), loss_s: new Float64Array(count), stand_s: new Float64Array(count),
      known: 0, looked: 0, ends: true,
    };
    const r = [0, 0, 0];
    const h = [0, 0, 0];
    for (let k = 0; k < COUNT; k += 1) {
      const logged = crowd ? crowd.logged[k] : facts.tracks.logged[k];
      let leg = 0;
      let moving = true;
      let at = 0; // of the motion, nominal; of the stand, elapsed
      let scaling = 1;
      let s; // as it follows
      let held;
      const recent = [];
      const queue = [];
      let spliced = 0;
      let ownLoss = 0;
      let lost = 0;
      let end_s = NaN;
      for (let number = 0; number < steps; number += 1) {
        const part = parts[leg];
        const stand = part.usual_s > 0 ? tables.stands[part.drawn + k] : 0;
        const t = ((number + 0.5) * step_s) / STEP_S;
        const sample = Math.floor(t + NOTHING);
        const looks = number % looksAfter === 0;
        const asks = follows || moving || stand - at < step_s;
        if (asks || looks) {
          const place = moving ? Math.min(at + (scaling * step_s) / 2, part.nominal_s) : part.nominal_s;
          const middle = (Math.min(Math.floor((part.begins_s + place) / cell_s), cells - 1) + 0.5) * cell_s - part.begins_s;
          const share = moving ? Math.min(Math.max(middle / Math.max(part.nominal_s, NOTHING), 0), 1) : 1;
          const phase = share * (part.points - 1);
          const point = Math.min(Math.floor(phase), part.points - 1);
          const next = Math.min(point + 1, part.points - 1);
          const far = phase - point;
          const here = 3 * (part.first + point);
          const there = 3 * (part.first + next);
          for (let axis = 0; axis < 3; axis += 1) r[axis] = paths[here + axis] + (paths[there + axis] - paths[here + axis]) * far;
          const first = k * samples;
          const from = k * SAMPLES + (crowd ? crowd.at[first + sample] : sample);
          const to = k * SAMPLES + (crowd ? crowd.at[first + sample + 1] : sample + 1);
          const weight = t - sample;
          for (let axis = 0; axis < 3; axis += 1) {
            const now = people[3 * from + axis];
            const between = now + (people[3 * to + axis] - now) * weight;
            h[axis] = Number.isNaN(between) ? now : between;
          }
          if (Number.isNaN(h[2])) h[2] = r[2];
          if (looks) {
            found.looked += 1;
            const robot = tables.robot_cells[part.first + (far < 0.5 ? point : next)];
            const human = tables.people_cells[weight < 0.5 ? from : to];
            if (human === NOBODY || tables.support[robot * facts.support.operators + human]) found.known += 1;
          }
        }
        if (follows) {
          let wanted = safety(r, h, false);
          if (rule.lags) { // Follower: s falls by one side and rises by the other
            const rising = safety(r, h, true);
            wanted = Math.max(wanted, rising);
            held = held === undefined ? wanted : Math.min(Math.max(held, rising), wanted);
            wanted = held;
          }
          if (hold > 1) {
            recent.push(wanted);
            if (recent.length > hold) recent.shift();
            wanted = Math.min(...recent);
          }
          if (delay > 0) {
            queue.push(wanted);
            wanted = queue.length > delay ? queue.shift() : queue[0];
          }
          if (s !== undefined) {
            if (down && wanted < s - down * step_s) wanted = s - down * step_s;
            if (up && wanted > s + up * step_s) wanted = s + up * step_s;
          }
          s = wanted;
          scaling = wanted;
        } else {
          scaling = asks ? safety(r, h, false) : 1;
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
            found.loss_s[leg] += (1 - rate) * spent;
          } else found.stand_s[leg] += spent;
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
      if (Number.isNaN(end_s)) return { ends: false };
      found.duration_s[k] = end_s;
      found.lost_s[k] = lost;
      found.ownLoss_s[k] = ownLoss;
      found.ownBase_s[k] = Math.max(end_s - spliced - ownLoss, 0);
    }
    for (const sums of [found.loss_s, found.stand_s]) for (let n = 0; n < count; n += 1) sums[n] /= COUNT;
    return found;
  };

  // ---- statistics: `resample`, `history`, `means`, `conformal`

  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
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

  const inResamples = (values) => { // the mean of K values in each resample of the executions
    const executions = tables.drawn.length / tables.errors.length;
    const sum = new Float64Array(executions);
    const size = new Float64Array(executions);
    for (let k = 0; k < COUNT; k += 1) {
      sum[tables.execution[k]] += values[k];
      size[tables.execution[k]] += 1;
    }
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

  const resampledMeans = (cycles) => { // Rolled.resampled_means
    const usual = mean(cycles.ownLoss_s) / Math.max(mean(cycles.ownBase_s), NOTHING);
    if (usual <= 0) return inResamples(cycles.duration_s);
    const [loss, base] = [inResamples(cycles.ownLoss_s), inResamples(cycles.ownBase_s)];
    const free = inResamples(cycles.duration_s.map((value, k) => value - cycles.lost_s[k]));
    const lost = mean(cycles.lost_s);
    return free.map((value, row) => value + (lost * (loss[row] / Math.max(base[row], NOTHING))) / usual);
  };

  const meansOf = (cycles, legs) => { // means_of: factor, resampled mean and error of the cell as it was logged
    const check = facts.check;
    const resampled = resampledMeans(cycles).map((value) => value * check.factor);
    const alone = { factor: check.factor, resampled, error: check.model_error };
    const names = Object.keys(check.history);
    if (check.order_error === null || !legs.every((name) => name in check.history)) return alone;
    const rollout_s = mean(cycles.duration_s) * check.factor;
    const history_s = legs.reduce((sum, name) => sum + check.history[name], 0);
    const size = tables.errors.length;
    const history = new Float64Array(size);
    for (const name of legs) {
      const from = names.indexOf(name) * size;
      for (let row = 0; row < size; row += 1) history[row] += tables.history[from + row];
    }
    const order = check.order_error / Math.sqrt(legs.length);
    const [one, other] = [resampled, history].map((values) => {
      const middle = mean(values);
      return values.map((value) => value / middle);
    });
    const together = covariance(one, other);
    const mine = covariance(one, one) + check.model_error ** 2 - together;
    const its = covariance(other, other) + order ** 2 + (history_s / rollout_s - 1) ** 2 - together;
    const share = mine + its > 0 ? Math.min(Math.max(mine / (mine + its), 0), 1) : 0;
    const expected = rollout_s + share * (history_s - rollout_s);
    return {
      factor: (check.factor * expected) / rollout_s,
      resampled: resampled.map((value, row) => (1 - share) * value + share * history[row]),
      error: Math.hypot((1 - share) * check.model_error, share * order),
      moved: expected / rollout_s,
    };
  };

  const entryOf = (cycles, means, legs, takt_s) => { // entry_of: what the cycles say
    const durations = cycles.duration_s.map((value) => value * means.factor);
    const expected = mean(durations);
    const bias = facts.check.doubted_bias;
    const spread = sorted(means.resampled.map((value, row) => value * (1 + means.error * tables.errors[row])));
    const off = tables.residuals ? durations.map((value, k) => value * (1 + tables.residuals[k])) : durations;
    const single = sorted(off);
    const conformal = Boolean(tables.residuals);
    const takt = takt_s > 0 ? [0, bias, -bias].map((by) => durations.map((value) => Number(value * (1 + by) <= takt_s))) : null;
    const lost = cycles.loss_s.reduce((sum, value) => sum + value, 0);
    const slower = lost > 0 ? Math.max(1 + ((means.factor - 1) * mean(cycles.duration_s)) / lost, 0) : 1;
    const nominal = legs.reduce((sum, name) => sum + facts.legs[name].nominal_s, 0);
    const stands = cycles.stand_s.reduce((sum, value) => sum + value, 0);
    const stretch = stands > 0 ? (expected - nominal - lost * slower) / stands : 0;
    return {
      expected_s: expected,
      durations_s: [...durations],
      low_s: quantile(spread, 0.025) - bias * expected,
      high_s: quantile(spread, 0.975) + bias * expected,
      quantiles_s: [0.05, 0.5, 0.95].map((level) => quantile(single, level, conformal)),
      takt: takt && [
        mean(takt[0]), quantile(sorted(inResamples(takt[1])), 0.025), quantile(sorted(inResamples(takt[2])), 0.975),
      ],
      safety_s: lost * slower,
      support: cycles.known / cycles.looked,
      tasks: legs.map((name, n) => {
        const leg = facts.legs[name];
        const stand = cycles.stand_s[n] * stretch;
        const dwell = leg.dwell_s + leg.wait_s > 0 ? leg.dwell_s / (leg.dwell_s + leg.wait_s) : 1;
        const parts = [leg.nominal_s, cycles.loss_s[n] * slower, stand * dwell, stand * (1 - dwell)];
        return { name, parts, logged: leg.logged };
      }),
    };
  };

  const rolled = (legs, asked) => { // cycles_of: tracks as long as the slowest cycle takes
    const nominal = legs.reduce((sum, name) => {
      const leg = facts.legs[name];
      return sum + leg.nominal_s + leg.dwell_s + leg.wait_s;
    }, 0);
    const safety = safetyOf(asked.moved);
    const ramp = asked.ramp === null ? {} : { ramp_up_per_s: asked.ramp };
    const dynamics = { ...facts.dynamics, ...ramp };
    for (let horizon = 2.5 * nominal; ; horizon *= 2) {
      const samples = Math.min(SAMPLES, Math.ceil(horizon / STEP_S) + 2);
      let crowd = null;
      if (asked.frequency !== 1) {
        const key = ["away", asked.moved, samples, [...new Set(legs)]].join();
        crowd = asOften(asked.frequency, remembered(key, () => awayOf(legs, safety, samples)), samples);
        if (crowd.unknown) return crowd;
      }
      const cycles = walk(legs, safety, dynamics, crowd, samples);
      if (cycles.ends) return cycles;
      if (samples === SAMPLES) return { unknown: say("no_end") };
    }
  };

  const AS_LOGGED = () => ({ moved: facts.rule.moves.map(() => 0), ramp: null, frequency: 1 });
  const isLogged = (asked) => asked.ramp === null && asked.frequency === 1 && asked.moved.every((by) => by === 0);

  const answer = (places, asked, takt_s) => {
    const legs = places.slice(1).map((place, n) => `${places[n]}->${place}`);
    if (!legs.length) return { unknown: say("no_visit") };
    const missing = [...new Set(legs.filter((name) => !(name in facts.legs)))];
    if (missing.length) return { unknown: say("never_logged", { tasks: missing.map(shown).join(", ") }), missing };
    const base = remembered(legs.join(), () => {
      const cycles = rolled(legs, AS_LOGGED());
      return cycles.unknown ? cycles : { cycles, means: meansOf(cycles, legs) };
    });
    if (base.unknown) return base;
    let { cycles, means } = base;
    if (!isLogged(asked)) {
      cycles = rolled(legs, asked);
      if (cycles.unknown) return cycles;
      const factor = facts.check.factor * (base.means.moved || 1);
      const resampled = resampledMeans(cycles).map((value) => value * factor);
      means = { factor, resampled, error: facts.check.model_error };
    }
    const entry = entryOf(cycles, means, legs, takt_s);
    if (entry.support < 0.5) return { unknown: say("thin", { share: percent(entry.support) }) };
    return entry;
  };
  const labelled = (place) => facts.labels[place] || place;
  const shown = (task) => task.split("->").map(labelled).join(" \u2192 ");
  const percent = (share) => `${Math.round(share * 100)}\u00a0%`;

  // ---- what is played with

  const section = document.getElementById("play");
  const part = (name) => section.querySelector(`[data-play="${name}"]`);
  const made = (tag, className, text) => {
    const element = document.createElement(tag);
    if (className) element.className = className;
    if (text !== undefined) element.textContent = text;
    return element;
  };
  const state = { number: 0, visits: [], end: null, asked: null, takt_s: facts.takt_s };

  const visitsOf = (places) => { // a place that comes before many others is fetched from: it moves with the next ones
    const rest = places.slice(1);
    const end = rest.length > 1 && rest[rest.length - 1] === places[0] ? rest.pop() : null;
    const often = (place) => rest.filter((each) => each === place).length;
    const hub = rest.reduce((best, place) => (often(place) > often(best) ? place : best), rest[0]);
    const visits = [];
    for (const place of rest) {
      const last = visits[visits.length - 1];
      if (often(hub) > 1 && place !== hub && last && last.places[0] === hub) last.places.push(place);
      else visits.push({ places: [place], on: true });
    }
    return { visits, end };
  };
  const placesOf = () => {
    const first = facts.sequences[state.number].places[0];
    const middle = state.visits.filter((visit) => visit.on).flatMap((visit) => visit.places);
    return [first, ...middle, ...(state.end === null ? [] : [state.end])];
  };
  const tomlOf = () => {
    const quoted = (text) => JSON.stringify(text).replace(/\u007f/g, "\\u007f");
    const name = say("played", { name: facts.sequences[state.number].name });
    return `[[sequence]]\nname = ${quoted(name)}\nplaces = [${placesOf().map(quoted).join(", ")}]\n`;
  };

  const fixed = (seconds) => seconds.toFixed(1);
  const apartFrom = (value, before) => {
    const by = value - before;
    if (Math.abs(by) < 0.05) return say("same");
    return say(by < 0 ? "shorter" : "longer", { by: fixed(Math.abs(by)) });
  };

  const showNumbers = (entry, given) => {
    const known = !entry.unknown;
    part("mean").textContent = known ? say("seconds", { value: fixed(entry.expected_s) }) : say("not_known");
    const interval = known ? say("interval", { low: fixed(entry.low_s), high: fixed(entry.high_s) }) : entry.unknown;
    part("interval").textContent = interval;
    part("change").textContent = known && !given.unknown ? apartFrom(entry.expected_s, given.expected_s) : "";
    const [low, , high] = known ? entry.quantiles_s : [];
    const cells = {
      single: known ? say("range", { low: fixed(low), high: fixed(high) }) : "\u2013",
      safety: known ? say("seconds", { value: fixed(entry.safety_s) }) : "\u2013",
      support: known ? percent(entry.support) : "\u2013",
      takt: known && entry.takt
        ? say("within", { share: percent(entry.takt[0]), low: percent(entry.takt[1]), high: percent(entry.takt[2]) })
        : "\u2013",
    };
    for (const [name, text] of Object.entries(cells)) part(name).textContent = text;
    part("thin").hidden = !(known && entry.support < 0.9);
    if (known) part("thin").textContent = say("extrapolated", { share: percent(1 - entry.support) });
  };

  const KINDS = ["motion", "slow", "dwell", "wait"];
  const lane = (item, tasks, start_s, whole_s) => {
    const bar = item.querySelector(".play-lane");
    bar.replaceChildren();
    let at = start_s;
    for (const task of tasks) {
      const texts = [];
      const begin = at;
      task.parts.forEach((seconds, kind) => {
        if (seconds < 0.005) return;
        const piece = made("i", `play-${KINDS[kind]}`);
        piece.style.left = `${(100 * at) / whole_s}%`;
        piece.style.width = `${(100 * seconds) / whole_s}%`;
        at += seconds;
        bar.append(piece);
        texts.push(`${words[KINDS[kind]]} ${fixed(seconds)} s`);
      });
      const title = `${shown(task.name)}: ${fixed(begin)}\u2013${fixed(at)} s; ${texts.join(", ")}; ${say("seen", { count: task.logged })}`;
      for (const piece of bar.children) if (!piece.title) piece.title = title;
    }
    return at;
  };

  const showChart = (entry, given) => {
    const list = part("visits");
    for (const bar of section.querySelectorAll(".play-lane")) bar.replaceChildren();
    const slowest = Math.max(entry.expected_s || 0, given.expected_s || 0, state.takt_s || 0, 1);
    const every = [1, 2, 5, 10, 20, 30, 60, 120, 300].find((step) => slowest / step <= 7) || 600;
    const whole = Math.ceil(slowest / every) * every;
    const axis = part("axis");
    axis.replaceChildren();
    for (let tick = 0; tick <= whole + NOTHING; tick += every) {
      const mark = made("span", "", tick ? String(tick) : "0 s");
      mark.style.left = `${(100 * tick) / whole}%`;
      axis.append(mark);
    }
    section.style.setProperty("--play-every", `${(100 * every) / whole}%`);
    if (entry.unknown) return;
    let [at, first] = [0, 0];
    for (const item of list.children) {
      const visit = state.visits[Number(item.dataset.visit)];
      if (!visit.on) continue;
      at = lane(item, entry.tasks.slice(first, first + visit.places.length), at, whole);
      first += visit.places.length;
    }
    if (state.end !== null) lane(part("end"), entry.tasks.slice(first), at, whole);
  };

  const update = () => {
    const began = performance.now();
    const entry = answer(placesOf(), state.asked, state.takt_s);
    const given = remembered(["given", state.number, state.takt_s].join(),
      () => answer(facts.sequences[state.number].places, AS_LOGGED(), state.takt_s));
    showNumbers(entry, given);
    showChart(entry, given);
    section.dataset.took = String(performance.now() - began);
    part("toml").hidden = true;
    part("copied").textContent = "";
  };

  // ---- the controls

  const describe = (visit) => visit.places.map(labelled).join(" \u2192 ");
  const move = (from, to) => {
    if (to < 0 || to >= state.visits.length || to === from) return;
    state.visits.splice(to, 0, ...state.visits.splice(from, 1));
    list();
    update();
  };
  const button = (text, label, act) => {
    const found = made("button", "", text);
    found.type = "button";
    found.setAttribute("aria-label", label);
    found.addEventListener("click", act);
    return found;
  };

  const dragged = (handle, item) => {
    handle.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      handle.setPointerCapture(event.pointerId);
      item.classList.add("held");
    });
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      const others = [...item.parentElement.children].filter((each) => each !== item);
      const below = others.find((each) => {
        const box = each.getBoundingClientRect();
        return event.clientY < box.top + box.height / 2;
      });
      const next = below || null;
      if (item.nextElementSibling !== next) {
        item.parentElement.insertBefore(item, next);
        handle.setPointerCapture(event.pointerId); // it is lost where the item moves
        state.visits = [...item.parentElement.children].map((each) => state.visits[Number(each.dataset.visit)]);
        [...item.parentElement.children].forEach((each, index) => { each.dataset.visit = String(index); });
        update();
      }
    });
    const drop = () => {
      if (!item.classList.contains("held")) return;
      item.classList.remove("held");
      list();
    };
    handle.addEventListener("pointerup", drop);
    handle.addEventListener("pointercancel", drop);
  };

  const list = () => {
    const visits = part("visits");
    visits.replaceChildren(...state.visits.map((visit, index) => {
      const item = made("li");
      item.dataset.visit = String(index);
      const handle = made("span", "play-handle", "\u2261");
      handle.setAttribute("aria-hidden", "true");
      const label = made("label");
      const box = made("input");
      box.type = "checkbox";
      box.checked = visit.on;
      box.addEventListener("change", () => {
        visit.on = box.checked;
        item.classList.toggle("off", !visit.on);
        update();
      });
      label.append(box, ` ${describe(visit)}`);
      item.classList.toggle("off", !visit.on);
      const step = (by) => () => {
        move(index, index + by);
        const moved = visits.children[index + by];
        const [back, on] = moved ? moved.querySelectorAll("button") : [];
        const focus = by < 0 ? [back, on] : [on, back];
        if (moved) (focus[0].disabled ? focus[1] : focus[0]).focus();
      };
      const name = { name: describe(visit) };
      const [earlier, later] = [button("\u2191", say("earlier", name), step(-1)), button("\u2193", say("later", name), step(1))];
      earlier.disabled = index === 0;
      later.disabled = index === state.visits.length - 1;
      const row = made("div", "play-row");
      row.append(handle, label, earlier, later);
      item.append(row, made("div", "play-lane"));
      dragged(handle, item);
      return item;
    }));
    const first = facts.sequences[state.number].places[0];
    part("start").textContent = labelled(first);
    part("end").hidden = state.end === null;
    part("end").querySelector(".play-row").textContent = state.end === null ? "" : labelled(state.end);
  };

  const sliders = [];
  const slider = (label, bounds, step, start, tell, set) => {
    const row = made("div", "play-slider");
    const name = made("label", "", label);
    const input = made("input");
    const value = made("output");
    const back = button(say("as_logged"), `${label}: ${say("as_logged")}`, () => {
      input.value = String(start);
      input.dispatchEvent(new Event("input"));
    });
    input.type = "range";
    [input.min, input.max, input.step] = [...bounds, step].map(String);
    input.id = `play-slider-${sliders.length}`;
    name.htmlFor = input.id;
    value.htmlFor = input.id;
    const turn = () => {
      const now = Number(input.value);
      const logged = Math.abs(now - start) < step / 2;
      set(logged ? null : now);
      value.textContent = logged ? say("logged", { value: tell(start) }) : tell(now);
      input.setAttribute("aria-valuetext", value.textContent);
      back.disabled = logged;
    };
    input.addEventListener("input", () => { turn(); update(); });
    row.append(name, input, value, back);
    part("sliders").append(row);
    const reset = () => { input.value = String(start); turn(); };
    sliders.push(reset);
    reset();
  };

  const AT_ONCE = 1.01; // behind 10 per s, on a logarithmic scale
  const allSliders = () => {
    facts.rule.moves.forEach((each, index) => {
      const level = percent(each.level);
      const label = say(each.kind === "zone" ? "zone" : "threshold", { level });
      const tell = (by) => say("metres", { value: (each.value + by).toFixed(2) });
      const bounds = each.bounds.map((bound) => bound - each.value);
      const [low, high] = [Math.ceil(bounds[0] * 100 - NOTHING) / 100, Math.floor(bounds[1] * 100 + NOTHING) / 100];
      slider(label, [low, high], 0.01, 0, tell, (by) => { state.asked.moved[index] = by || 0; });
    });
    const logged = facts.dynamics.ramp_up_per_s;
    const start = logged ? Math.round(Math.log10(Math.min(logged, 10)) * 100) / 100 : AT_ONCE;
    const rate = (at) => (at > 1.005 ? Infinity : 10 ** at);
    const tell = (at) => (at > 1.005 ? say("at_once") : say("per_s", { value: Math.round(100 * (at === start ? logged : 10 ** at)) }));
    slider(say("recovery"), [-1.5, AT_ONCE], 0.01, start, tell, (at) => { state.asked.ramp = at === null ? null : rate(at); });
    const often = (by) => say("times", { value: by.toFixed(2) });
    slider(say("frequency"), [0.1, 2], 0.05, 1, often, (by) => { state.asked.frequency = by === null ? 1 : by; });
  };

  const begin = (number) => {
    state.number = number;
    Object.assign(state, visitsOf(facts.sequences[number].places));
    for (const reset of sliders) reset();
    list();
    update();
  };

  const start = async () => {
    await unpack();
    prepare();
    section.hidden = false;
    state.asked = AS_LOGGED();
    const select = part("sequence");
    select.append(...facts.sequences.map((each, index) => new Option(each.name, String(index))));
    select.addEventListener("change", () => begin(Number(select.value)));
    part("reset").addEventListener("click", () => begin(state.number));
    const takt = part("takt_s");
    takt.value = state.takt_s === null ? "" : String(state.takt_s);
    takt.addEventListener("input", () => { state.takt_s = Number(takt.value) || null; update(); });
    part("copy").addEventListener("click", async () => {
      const text = part("toml");
      text.value = tomlOf();
      text.hidden = false;
      text.select();
      let copied = false;
      try {
        await navigator.clipboard.writeText(text.value);
        copied = true;
      } catch {
        copied = document.execCommand("copy");
      }
      part("copied").textContent = say(copied ? "copied" : "select_it");
    });
    allSliders();
    begin(0);
    section.dataset.ready = "yes";
  };
  window.cyclekitPlay = { ready: start(), answer: (places, asked, takt_s) => answer(places, { ...AS_LOGGED(), ...asked }, takt_s) };
})();
