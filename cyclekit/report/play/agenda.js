// ---- what each agent does in a plan: `joint.legs`, `joint.plans`, `joint.draws`

const APART = "\n"; // of the parts of an event: whose, where, what, the how manieth
const gateOf = (agent, at, place) => facts.gates.find((gate) => gate.agent === agent && gate.at === at && gate.place === place);
const conditionsOf = (gate, asked) => {
  if (!gate || asked.without.includes(gate.name)) return [];
  return gate.conditions;
};
const needsOf = (agent, at, place, turn, asked) => conditionsOf(gateOf(agent, at, place), asked).flatMap((one) => {
  const { every, first, event_every: eventEvery, event_first: eventFirst } = one.turns;
  const back = one.back ? one.back + (asked.more[one.place] || 0) : 0;
  const passage = Math.floor(turn / every);
  if (turn % every !== first || passage < back) return [];
  const number = (passage - back) * eventEvery + eventFirst;
  const event = [one.agent, one.place, one.kind, number].join(APART);
  const { said, lag_s, soonest_s, needed, together, common } = one;
  return [{ event, said, lag_s, soonest_s, needed, together, common, passage }];
});
const ownByOf = (place, before, next, asked) => { // Gates.own_by_s: own work by the places around it
  const gate = gateOf("operator", "leave", place);
  const mine = gate && gate.own_by.find((one) => one.place === (one.side === "before" ? before : next));
  return mine ? mine.own_s.map((seconds) => seconds / asked.pace) : null;
};
const ownOf = (agent, place, asked) => {
  const gate = gateOf(agent, "leave", place);
  if (!gate || !(Math.max(...gate.own_s) > 0)) return null;
  return agent === "operator" ? gate.own_s.map((seconds) => seconds / asked.pace) : gate.own_s;
};
const NOTHING_S = [0];

const agendaOf = (agent, start, at, asked, planned = []) => { // _Builder: legs one behind the other
  const blank = {
    task: -1, path: null, way_s: 0, start: null, own_s: NOTHING_S, name: "", needs: [], notBefore_s: 0, arrives: [], passes: [],
    hold: false, trip: null, ifWaits: false,
  };
  const tripOf = (gate) => (gate && gate.trip && !gate.trip.places.some((place) => planned.includes(place)) ? gate.trip : null);
  const legs = [{ ...blank, place: start, path: at }];
  const visits = new Map(start ? [[start, 1]] : []);
  const done = new Map();
  const passes = (what, place) => legs[legs.length - 1].passes.push([agent, place, what, (visits.get(place) || 0) - 1].join(APART));
  const go = (task, name, told, asks) => { // asks: what a plan adds to it
    const here = legs[legs.length - 1].place;
    const { place } = told;
    const turn = visits.get(place) || 0;
    const gate = gateOf(agent, "approach", place);
    const approach = needsOf(agent, "approach", place, turn, asked);
    const phase = agent === "robot" && gate ? gate.phase : 0;
    const midway = phase > 0 ? approach : [];
    const before = [...asks.needs, ...(phase > 0 ? [] : approach)];
    const over = gate && gate.wait_at && (!gate.wait_from.length || gate.wait_from.includes(here));
    const spot = over && approach.length && here !== gate.wait_at ? gate.wait_at : null; // he goes there only if he has to wait
    const stays = !spot && !(agent === "operator" && here === place); // else he leaves before he waits
    const leaves = () => { if (here) for (const what of ["leaves", "cleared"]) passes(what, here); };
    const asked_for = { name: `hold ${place}`, needs: before, notBefore_s: asks.notBefore_s, hold: true };
    if (!stays) leaves();
    if (spot) {
      legs.push({ ...blank, task, place: spot, start: here, ...asked_for, ifWaits: true, passes: [] });
    } else if (before.length || asks.notBefore_s > 0) {
      const { path } = legs[legs.length - 1];
      const stays = path && { ...path, low: path.high };
      if (gate && gate.trip) legs[legs.length - 1].trip = null; // no second trip before it leaves here
      legs.push({ ...blank, task, place: here, path: stays, ...asked_for, trip: tripOf(gate), passes: [] });
    }
    if (stays) leaves();
    const times = done.get(name) || 0;
    const last = {
      ...blank, ...told, ...(spot && { start: spot }), task, needs: needsOf(agent, "leave", place, turn, asked), trip: tripOf(gateOf(agent, "leave", place)),
      arrives: [[agent, place, "arrives", turn].join(APART)],
      passes: [[agent, name, "done", times].join(APART), [agent, place, "set", turn].join(APART)],
    };
    if (midway.length) {
      const { path } = told;
      const row = Math.min(Math.max(1, halfToEven(phase * path.high)), path.high);
      const first = { ...path, high: row };
      legs.push({ ...blank, task, place, path: first, way_s: phase * told.way_s, name: `approach ${place}`, needs: midway, passes: [] });
      legs.push({ ...last, path: { ...path, low: row }, way_s: (1 - phase) * told.way_s });
    } else legs.push(last);
    visits.set(place, turn + 1);
    done.set(name, times + 1);
  };
  const ended = (tasks) => {
    passes("leaves", legs[legs.length - 1].place);
    return { agent, legs, tasks };
  };
  return { go, ended };
};
const halfToEven = (value) => { // as Python rounds
  const below = Math.floor(value);
  if (value - below !== 0.5) return Math.round(value);
  return below % 2 ? below + 1 : below;
};

const AS_LEARNED = { needs: [], notBefore_s: 0 };
const calledOf = (places, task, n) => (task.name.includes("->") ? `${places[n]}->${places[n + 1]}` : task.name);
const askedOf = (robot, tasks) => { // legs.told_needs, by what the tasks are called in this order
  const all = [
    ...tasks.robot.map((task, n) => ({ ...task, agent: "robot", called: calledOf(robot, task, n) })),
    ...tasks.operator.map((task) => ({ ...task, agent: "operator", called: task.name })),
  ];
  const whose = ({ agent, called }) => [agent, called].join(APART);
  const count = new Map();
  for (const task of all) {
    task.turn = count.get(whose(task)) || 0;
    count.set(whose(task), task.turn + 1);
  }
  const missing = new Set();
  for (const task of all) {
    const known = (one) => all.find(({ number }) => number === one.number)
      || all.find(({ agent, name }) => agent === one.agent && name === one.name);
    for (const one of task.after) if (!known(one)) missing.add(one.name);
    task.comesAfter = [...new Set(task.after.filter(known).map((one) => known(one).called))];
    task.needs = task.comesAfter.flatMap((called) => {
      const able = ["robot", "operator"].map((agent) => [agent, called].join(APART))
        .filter((key) => count.has(key) && key !== whose(task));
      if (!able.length) missing.add(called);
      return able.map((key) => ({
        event: [key, "done", Math.min(task.turn, count.get(key) - 1)].join(APART), said: key, lag_s: NOTHING_S, soonest_s: 0, needed: 1,
      }));
    });
    task.notBefore_s = task.not_before_s;
  }
  return {
    robot: all.filter(({ agent }) => agent === "robot"), operator: all.filter(({ agent }) => agent === "operator"),
    missing: [...missing],
  };
};

const robotAgenda = (places, asked, told) => { // told: what a plan says of each task
  const names = places.slice(1).map((place, n) => `${places[n]}->${place}`);
  const pathOf = (name) => ({ first: facts.legs[name].first, low: 0, high: facts.legs[name].points - 1 });
  const agenda = agendaOf("robot", places[0], { ...pathOf(names[0]), high: 0 }, asked);
  names.forEach((name, number) => {
    const leg = facts.legs[name];
    const place = places[number + 1];
    const asks = told ? told[number] : AS_LEARNED;
    const own_s = ownOf("robot", place, asked) || leg.stands_s;
    agenda.go(number, asks.called || name, { place, path: pathOf(name), way_s: leg.nominal_s, own_s, name }, asks);
  });
  return agenda.ended(names);
};

const operatorAgenda = (places, asked, told, begun) => { // begun: his first work, before the cycle begins
  const agenda = agendaOf("operator", "", null, asked, places);
  const waits = facts.gates.some((gate) => gate.agent === "operator" && gate.conditions.length); // in the logs
  places.forEach((place, number) => {
    const stays = facts.work_s[place];
    const before = number ? places[number - 1] : begun ? "" : null;
    const own = ownByOf(place, before, places[number + 1], asked) || (waits ? ownOf("operator", place, asked) : null);
    const first = number ? null : facts.first_stays_s[place];
    const worked = stays || !facts.first_stays_s[place];
    const work = (worked && own) || (stays || first || NOTHING_S).map((seconds) => seconds / asked.pace);
    agenda.go(number, place, { place, start: number ? places[number - 1] : "", own_s: work, name: place }, told ? told[number] : AS_LEARNED);
  });
  return agenda.ended(places);
};

const sourceAgenda = (source, robot, asked) => { // JointCell.source
  const taken = robot.legs.flatMap((leg) => [...leg.arrives, ...leg.passes]).map((event) => event.split(APART))
    .filter(([, where, what]) => where === source.taken_by && what === "leaves");
  const count = 1 + Math.max(-1, ...taken.map((event) => Number(event[3])));
  const buffer = asked.buffer[source.signal] || source.buffer;
  const legs = Array.from({ length: count }, (_, part) => ({
    task: part, place: "", path: null, way_s: 0, start: null, hold: false, name: source.signal, notBefore_s: source.first_s[0] < 0 ? -Infinity : 0,
    own_s: part ? source.gap_s : source.first_s,
    needs: part < buffer ? [] : [{
      event: ["robot", source.taken_by, "leaves", part - buffer].join(APART), said: source.said, lag_s: NOTHING_S, soonest_s: 0, needed: 1,
    }],
    arrives: [],
    passes: [["signal", source.signal, source.kind, part].join(APART)],
  }));
  return count ? { agent: "signal", legs, tasks: [] } : null;
};

const chanceOf = (need, key, turn) => // one level for both, where they wait in the same passages
  (need.together ? levelsOf(`together ${need.together}`, need.passage) : levelsOf(`${key} needs ${need.said}`, turn));
const drawnOf = (agenda, number) => { // Drawn: levels of own work, lags, walks and stays, by cycle; events by number
  const turns = new Map();
  const shared = facts.common || { work: 0, walk: 0 };
  const turnOf = (key) => {
    const turn = turns.get(key) || 0;
    turns.set(key, turn + 1);
    return turn;
  };
  return agenda.legs.map((leg, n) => {
    const key = `${agenda.agent} ${leg.name}`;
    const turn = turnOf(key);
    const work = leg.own_s.length > 1 ? levelsAlike(key, turn, agenda.agent === "operator" ? shareOf(leg.own_s, shared.work) : 0) : null;
    const found = {
      ...leg,
      arrives: leg.arrives.map(number),
      passes: leg.passes.map(number),
      work,
      due: leg.needs.map((need) => ({
        ...need,
        event: number(need.event),
        level: need.lag_s.length > 1 ? levelsAlike(`${key} after ${need.said}`, turn, need.common) : null,
        chance: need.needed < 1 ? chanceOf(need, key, turn) : null,
      })),
    };
    if (agenda.agent !== "operator") return found;
    const way = `walk ${leg.start === null ? "None" : leg.start}->${leg.place}`;
    const again = turnOf(way);
    if (leg.start !== null) {
      found.walks = facts.walks[leg.start][leg.place];
      const share = shareOf(found.walks.map((walk) => tookWalk_s(walk, 1)), shared.walk);
      found.walking = levelsAlike(way, again, share, true);
    }
    if (n && agenda.legs[n - 1].ifWaits) found.straight = facts.walks[agenda.legs[n - 1].start][leg.place]; // past the spot
    if (leg.place) [found.stays, found.staying] = [facts.stays[leg.place], levelsOf(`stay ${way}`, again)];
    if (n === agenda.legs.length - 1 && leg.place) [found.after, found.aftering] = [facts.after[leg.place], levelsOf(`after ${leg.place}`, 0)];
    if (leg.trip) {
      found.trips = facts.trips[leg.place].length ? facts.trips[leg.place] : null;
      [found.tripping, found.going] = [`trip from ${leg.name}`, `goes from ${leg.name}`].map((key) => levelsOf(key, again));
    }
    return found;
  });
};
const drawnFrom = (values, level, cycle) => { // drawn.quantile
  if (!level) return values[0];
  const place = level[cycle] * (values.length - 1);
  const below = Math.min(Math.floor(place), values.length - 2);
  return values[below] + (values[below + 1] - values[below]) * (place - below);
};
const chosen = (numbers, level, cycle) => numbers[Math.min(Math.floor(level[cycle] * numbers.length), numbers.length - 1)];
