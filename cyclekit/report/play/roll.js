// ---- plans of task lists: `learning.task_times.roll` and `estimate.task_times`

const beforeEach = (tasks) => { // number of the agent's own task before each task; -1: it is the first
  const last = new Map();
  return tasks.map((task, number) => {
    const before = last.has(task.asked) ? last.get(task.asked) : -1;
    last.set(task.asked, number);
    return before;
  });
};
const keyOf = (agent, task) => JSON.stringify([agent, task]);

const laidOut = (tasks, asked) => {
  const known = new Map(facts.tasks.map((card) => [keyOf(card.agent, card.task), card]));
  const cards = tasks.map((task) => known.get(keyOf(task.agent, task.name)));
  const turns = new Map();
  const turn = tasks.map((task, number) => {
    const key = keyOf(task.agent, task.name);
    if (!turns.has(key)) turns.set(key, []);
    return turns.get(key).push(number) - 1;
  });
  const position = tasks.map((task, number) => tasks.slice(0, number).filter((other) => other.agent === task.agent).length);
  const unknown = [];
  const needs = tasks.map((task, number) => {
    const nth = turn[number];
    const mine = cards[number].needs.filter((need) => !asked.without.includes(waitName(cards[number], need))).flatMap((need) => {
      const theirs = turns.get(keyOf(need.agent, need.task)) || [];
      const which = nth - need.back;
      const there = which >= 0 && which < theirs.length;
      const ofOwn = there && tasks[theirs[which]].agent === task.agent && theirs[which] > number; // no agent waits for its later task
      return there && !ofOwn ? [[theirs[which], need.after_s, need.needed, need.together]] : [];
    });
    for (const told of task.after) {
      const able = tasks.map((other, n) => n).filter((n) => tasks[n].name === told && n !== number);
      const ordered = [...turns.values()].flat().filter((n) => able.includes(n));
      if (ordered.length) mine.push([ordered[Math.min(nth, ordered.length - 1)], 0, 1, 0]);
      else unknown.push(told);
    }
    return mine;
  });
  const taken = new Map(); // as `prepared._parts`
  const parts = tasks.map((task, number) => {
    const card = cards[number];
    if (!card.parts || asked.without.includes(waitName(card, PART))) return null;
    const key = keyOf(task.agent, task.name);
    if (!taken.has(key)) taken.set(key, []);
    const mine = taken.get(key);
    mine.push(number);
    return { last: mine.at(-2) ?? -1, room: mine[mine.length - 1 - card.parts.buffer] ?? -1 };
  });
  const log = (rates, name) => Math.log(name in rates ? rates[name] : 1);
  const mate = cards.map(({ joint }, number) => {
    const theirs = joint ? turns.get(keyOf(joint.agent, joint.task)) || [] : [];
    return turn[number] < theirs.length ? theirs[turn[number]] : number;
  });
  return {
    cards, turn, position, needs, parts, unknown, mate, before: beforeEach(tasks),
    joined: cards.map(({ joint }, number) => mate[number] !== number && joint.starts),
    notBefore_s: tasks.map((task) => task.not_before_s || 0),
    ...Object.fromEntries([["rates", "nth", "position"], ["later"], ["waiting", "nth_waiting", "position_waiting"], ["at_start"]].map(([kind, nth, place]) => [
      kind, cards.map((card) => cards.map((other, m) => {
        const name = `${other.agent}: ${other.task}`;
        const at = (factors, number) => Math.log((factors && (card[factors][name] || [])[number]) || 1);
        return log(card[kind], name) + at(nth, turn[m]) + at(place, position[m]);
      })),
    ])),
    alone: cards.map((card) => log(card.rates, "")),
  };
};
const PART = { task: "part" }; // what a task waits for whose parts come by themselves
const everyWait = (card) => (card.parts ? [...card.needs, PART] : card.needs);
const waitName = (card, need) => `${card.task} for ${need.task}`;

const SHARES = 1000;
const DRAWS = new Map();
const drawsOf = (plan, tasks) => { // roll._drawn: which repetition each task draws, alike in every order of the same tasks
  const text = (a, b) => (a < b ? -1 : Number(a > b));
  const names = tasks.map((task, number) => ({ number, agent: task.agent, task: task.name, turn: plan.turn[number] }))
    .sort((a, b) => byCode(a.agent, b.agent, text) || byCode(a.task, b.task, text) || a.turn - b.turn);
  const partly = names.map(({ number }) => plan.needs[number].filter((need) => need[2] < 1));
  const order = partly.flat().length ? [partly, names.map(({ number }) => number)] : [];
  const key = JSON.stringify([names.map(({ agent, task, turn }) => [agent, task, turn]), ...order]);
  if (!DRAWS.has(key)) {
    const { below, shuffled } = generator(facts.seed);
    const drawn = (count) => { // roll._evenly
      const offset = below(SHARES);
      return shuffled(Uint16Array.from({ length: facts.cycles }, (_, rank) => rank))
        .map((rank) => Math.floor(((SHARES * rank + offset) * count) / (SHARES * facts.cycles)));
    };
    DRAWS.set(key, names.map(({ number }) => [drawn(plan.cards[number].work), drawn(plan.cards[number].lags)]));
    DRAWS.get(key).forEach((some, n) => {
      const { parts } = plan.cards[names[n].number];
      if (parts) some.push(drawn(names[n].turn ? parts.gaps : parts.first));
    });
    DRAWS.get(key).forEach((some, n) => {
      const count = plan.cards[names[n].number].need_lags;
      if (count) some.needLag = drawn(count);
    });
    const levels = new Map(); // roll._since_s: in which cycles a condition is needed that only some need
    DRAWS.get(key).forEach((some, n) => {
      some.often = new Map(partly[n].map(([other, , needed, together]) => {
        const which = together ? `${together} of turn ${names[n].turn}` : `${names[n].number} for ${other}`;
        if (!levels.has(which)) levels.set(which, drawn(SHARES));
        return [other, levels.get(which).map((level) => Number(level < needed * SHARES))];
      }));
    });
  }
  const found = [];
  DRAWS.get(key).forEach((drawn, n) => { found[names[n].number] = drawn; });
  return found;
};
const byCode = (one, other, compare) => { // by code points, as Python sorts
  const [a, b] = [[...one], [...other]];
  for (let n = 0; n < Math.min(a.length, b.length); n += 1) {
    const found = compare(a[n].codePointAt(0), b[n].codePointAt(0));
    if (found) return found;
  }
  return a.length - b.length;
};

const rolledPlan = (tasks, asked) => {
  const plan = laidOut(tasks, asked);
  if (plan.unknown.length) return { unknown: say("left_out", { tasks: [...new Set(plan.unknown)].join(", ") }) };
  const [count, cycles] = [tasks.length, facts.cycles];
  const draws = drawsOf(plan, tasks);
  const previous = plan.cards.map((_, n) => (plan.before[n] < 0 ? "" : plan.cards[plan.before[n]].task));
  const factor = plan.cards.map((card, n) => {
    const own = (card.turns[plan.turn[n]] || 1) * (card.own_position[plan.position[n]] || 1);
    return (previous[n] in card.after ? card.after[previous[n]] : 1) * own / (asked.paces[card.agent] || 1);
  });
  const start = tasks.map(() => new Float64Array(cycles));
  const end = tasks.map(() => new Float64Array(cycles));
  const decides = tasks.map(() => new Int16Array(cycles));
  const [work, half, lag, needLag, gap, begins, ends, rate, due] = Array.from({ length: 9 }, () => new Float64Array(count));
  const [running, late, held] = Array.from({ length: 3 }, () => new Uint8Array(count)); // held: done, but its joint task is not
  const halves = plan.later.some((row) => row.some((value) => value !== 0)); // else they are no events
  const next = tasks.map((_, number) => plan.before.indexOf(number));
  const partAt = (n) => { // as `roll._parts_s`
    if (!plan.parts[n]) return 0;
    const { last, room } = plan.parts[n];
    return Math.max(gap[n] + (last < 0 ? 0 : partAt(last)), room < 0 ? 0 : begins[room]);
  };
  let now = 0;
  const isNeeded = (n, need) => !draws[n].often.has(need) || draws[n].often.get(need)[now];
  const readyAt = (n) => {
    let ready = Math.max(plan.before[n] < 0 ? 0 : ends[plan.before[n]], plan.notBefore_s[n], partAt(n)) + lag[n];
    for (const [need, after_s] of plan.needs[n]) if (isNeeded(n, need)) ready = Math.max(ready, ends[need] + after_s + needLag[n]);
    return ready;
  };
  const startsAt = (n) => { // joint tasks that start together start when both may
    const at_s = readyAt(n);
    return plan.joined[n] ? Math.max(at_s, readyAt(plan.mate[n])) : at_s;
  };
  for (let cycle = 0; cycle < cycles; cycle += 1) {
    let [t, left] = [0, count];
    now = cycle;
    for (let n = 0; n < count; n += 1) {
      const card = plan.cards[n];
      work[n] = plan.joined[n] && plan.mate[n] < n ? 0 : factor[n] * tables.values[card.first + draws[n][0][cycle]];
      const least_s = card.needs.some((need) => need.after_s) ? -Infinity : 0; // roll.least_lag_s
      const after_s = previous[n] in card.lag_after_s ? card.lag_after_s[previous[n]] : 0;
      lag[n] = Math.max(tables.values[card.first + card.work + draws[n][1][cycle]] + after_s, least_s);
      needLag[n] = card.need_lags ? Math.max(tables.values[card.first + card.work + card.lags + draws[n].needLag[cycle]], least_s) : lag[n];
      if (plan.parts[n]) gap[n] = tables.values[card.first + card.work + card.lags + card.need_lags + (plan.turn[n] ? card.parts.first : 0) + draws[n][2][cycle]];
      half[n] = work[n] / 2;
      [begins[n], ends[n], running[n], late[n], held[n]] = [Infinity, Infinity, 0, Number(!halves), 0];
    }
    while (left) {
      let step = Infinity;
      let on = 0;
      for (let n = 0; n < count; n += 1) on += running[n];
      for (let n = 0; n < count; n += 1) {
        if (running[n]) {
          const sides = on - Number(plan.mate[n] !== n && running[plan.mate[n]]); // either side of a joint task is alone
          let sum = sides > 1 ? 0 : plan.alone[n];
          for (let m = 0; m < count; m += 1) {
            const waits = ends[m] < Infinity && next[m] >= 0 && begins[next[m]] === Infinity;
            if (sides > 1 && running[m] && m !== n) sum += plan.rates[n][m] + (late[m] ? 0.5 : -0.5) * plan.later[n][m];
            if (sides === 1 && waits) sum += plan.waiting[n][m];
          }
          rate[n] = Math.exp(sum);
          due[n] = held[n] ? Infinity : Math.max(work[n] - (late[n] ? 0 : half[n]), 0) / rate[n];
        } else due[n] = ends[n] < Infinity ? Infinity : Math.max(startsAt(n) - t, 0);
        step = Math.min(step, due[n]);
      }
      if (step === Infinity) return { unknown: say("stuck") };
      t += step;
      for (let n = 0; n < count; n += 1) {
        const now = due[n] <= step + 1e-9;
        if (running[n]) {
          work[n] -= rate[n] * step;
          held[n] |= Number(now && late[n]);
          late[n] |= Number(now);
        } else if (now) begins[n] = t;
      }
      for (let n = 0; n < count; n += 1) {
        if (running[n] && held[n] && held[plan.mate[n]]) { ends[n] = t; running[n] = 0; left -= 1; }
      }
      const beginning = begins.reduce((some, at_s, n) => (at_s < Infinity && ends[n] === Infinity && !running[n] ? [...some, n] : some), []);
      for (const n of beginning) { // the tasks that run when it starts change the whole task
        let sum = 0;
        for (let m = 0; m < count; m += 1) if (running[m]) sum += plan.at_start[n][m];
        work[n] *= Math.exp(sum);
        half[n] *= Math.exp(sum);
      }
      for (const n of beginning) running[n] = 1;
    }
    for (let n = 0; n < count; n += 1) {
      [start[n][cycle], end[n][cycle]] = [begins[n], ends[n]];
      let [latest, who] = [plan.before[n] < 0 ? 0 : ends[plan.before[n]], -1];
      if (plan.notBefore_s[n] > latest) [latest, who] = [plan.notBefore_s[n], -2];
      latest += lag[n];
      const other = plan.joined[n] ? plan.before[plan.mate[n]] : -1;
      const needs = plan.needs[n].map(([need, after_s]) => [need, after_s + needLag[n]]);
      for (const [need, after_s] of other < 0 ? needs : [...needs, [other, lag[n]]]) {
        if (isNeeded(n, need) && ends[need] + after_s > latest) [latest, who] = [ends[need] + after_s, need];
      }
      decides[n][cycle] = partAt(n) + lag[n] > latest ? -3 : who;
    }
  }
  return { plan, start, end, decides };
};

const biasOf = (check) => (Math.abs(check.bias) > facts.sure_bias * check.within ? check.bias : 0);

const expectedToo = (deviations, rolled) => { // task_times._expected_too
  const ordered = sorted(rolled);
  const [low, high] = [facts.outside, 1 - facts.outside].map((level) => quantile(ordered, level));
  if (deviations.filter((value) => value < low || value > high).length > facts.most_outside) return deviations;
  return [...deviations, ...Array.from({ length: facts.prior }, (_, n) => quantile(ordered, (n + 0.5) / facts.prior))];
};

const singleOf = (values, paceError) => { // task_times._single: ascending where it is corrected by held-out executions
  const deviations = tables.deviations;
  const [usual, spread] = [mean(values), spreadOf(values)];
  let off = values.map((value) => facts.widening * (value - usual));
  if (deviations && deviations.length >= facts.levels.length) {
    const ordered = sorted(expectedToo(deviations, spread ? values.map((value) => (value - usual) / spread) : [0]));
    const levels = facts.levels.map((level) => quantile(ordered, level, true));
    off = values.map((_, n) => spread * drawnFrom(levels, [n / (values.length - 1)], 0));
    const middle = mean(off);
    off = off.map((value) => value - middle);
  }
  const own = Math.sqrt(mean(off.map((value) => value ** 2)));
  const wider = own > 0 ? Math.hypot(1, paceError * usual / own) : 1;
  return off.map((value) => usual + wider * value);
};

const cycleTimes = ({ start, end }) => start[0].map((_, cycle) => Math.max(...end.map((times) => times[cycle])) - Math.min(...start.map((times) => times[cycle])));

const paceErrorOf = (tasks, asked, usual_s) => { // task_times._paces: the cycle with every changing agent slower by its error
  const changing = Object.entries(facts.pace_errors);
  if (!changing.length) return 0;
  const paces = Object.fromEntries(changing.map(([agent, error]) => [agent, (asked.paces[agent] || 1) * Math.exp(-error)]));
  return Math.abs(mean(cycleTimes(rolledPlan(tasks, { ...asked, paces: { ...asked.paces, ...paces } }))) / usual_s - 1);
};

const entryOfList = (tasks, rolled, asked) => {
  const { plan, start, end, decides } = rolled;
  const began = start[0].map((_, cycle) => Math.min(...start.map((times) => times[cycle])));
  const durations = cycleTimes(rolled);
  const { check, sure } = facts;
  const usual = mean(durations);
  let [expected, error] = [usual, spreadOf(durations) / usual / Math.sqrt(facts.executions)];
  if (check) {
    const bias = biasOf(check);
    expected = usual / (1 + bias);
    error = Math.hypot(Math.sqrt(Math.max(check.order_error ** 2 - bias ** 2, 0)), check.within, check.learning_error);
  }
  const factor = expected / usual;
  const paceError = paceErrorOf(tasks, asked, usual);
  error = Math.hypot(error, paceError);
  const single = singleOf(durations.map((value) => value * factor), paceError);
  const orders = {};
  for (const task of tasks) (orders[task.agent] = orders[task.agent] || []).push(task.name);
  const more = interludesIn_s(orders);
  const ordered = shifted(sorted(single), 0, more);
  return {
    expected_s: expected,
    durations_s: single,
    more,
    low_s: expected * (1 - sure * error),
    high_s: expected * (1 + sure * error) + more,
    quantiles_s: [0.05, 0.5, 0.95].map((level) => quantile(ordered, level, true)),
    tasks: tasks.map((task, n) => {
      const from = (values) => values.map((value, cycle) => value - began[cycle]);
      const ends = plan.before[n] < 0 ? began : end[plan.before[n]];
      const ordered_s = sorted(singleOf(from(end[n]).map((value) => value * factor), paceError));
      const counts = new Map();
      for (const who of decides[n]) counts.set(who, (counts.get(who) || 0) + 1);
      const [cause, times] = [...counts].sort((a, b) => b[1] - a[1])[0];
      return {
        agent: task.agent, asked: task.asked, name: task.name, logged: plan.cards[n].work,
        start_s: factor * mean(from(start[n])), end_s: factor * mean(from(end[n])),
        wait_s: factor * mean(start[n].map((value, cycle) => decides[n][cycle] === -1 ? 0 : value - ends[cycle])), // -1: its own task
        ends_s: [0.05, 0.95].map((level) => quantile(ordered_s, level, true)),
        after: cause < 0 ? null : `${tasks[cause].asked}: ${tasks[cause].name}`, part: times / decides[n].length,
      };
    }),
  };
};

const answerList = (tasks, asked, takt_s) => {
  if (!tasks.length) return { unknown: say("no_visit") };
  const entry = remembered(JSON.stringify(["list", tasks, asked]), () => {
    const rolled = rolledPlan(tasks, asked);
    return rolled.unknown ? rolled : entryOfList(tasks, rolled, asked);
  });
  if (entry.unknown) return entry;
  const ordered = sorted(entry.durations_s);
  const by = 1 - entry.low_s / entry.expected_s;
  const shares = [[by, takt_s - entry.more], [-by, takt_s]].map(([off, until_s]) => upTo(ordered, until_s / (1 + off)) / ordered.length);
  return { ...entry, takt: takt_s > 0 ? leastWide([shareUpTo(shifted(ordered, 0, entry.more), takt_s), ...shares]) : null };
};
