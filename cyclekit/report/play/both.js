// ---- one cycle of both agents: `joint.walk`; times of legs and events, s

const set = (events, numbers, time_s) => { for (const number of numbers) events[number] = time_s; };
const rowsOf = (drawn) => drawn.map((leg) => ({ // of one agent: one cycle after the other is put into them
  leg, path: leg.path, way_s: leg.way_s, lags: new Float64Array(leg.due.length), own_s: 0, walk_s: 0, walk: 0, stay: 0, straight: 0, after: -1,
  level: 0, waiting: false, free: false, trip: -1, goes: false, // trip -1: he stays
  arrives_s: Infinity, works_s: Infinity, passes_s: Infinity, lost_s: 0,
}));
const tookWalk_s = (walk, pace) => (facts.segments[walk][1] - 1) * STEP_S * facts.segments[walk][2] / pace;
const drawInto = (rows, cycle, events, asked) => { // what is drawn for one cycle
  for (const row of rows) {
    const { leg } = row;
    set(events, leg.arrives, Infinity);
    set(events, leg.passes, Infinity);
    row.own_s = Math.max(drawnFrom(leg.own_s, leg.work, cycle), Math.min(leg.notBefore_s, 0));
    leg.due.forEach((need, n) => {
      row.lags[n] = need.chance && need.chance[cycle] >= need.needed ? -Infinity : drawnFrom(need.lag_s, need.level, cycle);
    });
    if (leg.walks) {
      row.walk = chosen(leg.walks, leg.walking, cycle);
      row.walk_s = tookWalk_s(row.walk, asked.pace);
      if (leg.straight) row.straight = chosen(leg.straight, leg.walking, cycle);
    }
    if (leg.stays) row.stay = chosen(leg.stays, leg.staying, cycle);
    row.after = leg.after ? chosen(leg.after, leg.aftering, cycle) : -1;
    if (leg.trip) {
      row.level = leg.tripping[cycle];
      [row.waiting, row.free] = [leg.going[cycle] < leg.trip.waiting, leg.going[cycle] < leg.trip.free];
      row.trip = leg.trips ? chosen(leg.trips, leg.tripping, cycle) : -1;
      row.goes = false;
    }
    row.arrives_s = row.works_s = row.passes_s = Infinity;
    row.lost_s = 0;
  }
};
const afterTrip = (row, events, open_s, pace) => { // UnslowedAgent._after_trips: when he may depart after it
  let late_s = -Infinity;
  for (let n = 0; n < row.lags.length; n += 1) {
    const { event, soonest_s } = row.leg.due[n];
    if (row.lags[n] !== -Infinity) late_s = Math.max(late_s, events[event] + soonest_s);
  }
  late_s -= row.works_s;
  row.goes = late_s > 0 ? row.waiting : row.free;
  return row.goes ? Math.max(open_s, row.works_s + tookOf(row.leg.trip, late_s, row.level) / pace) : open_s;
};
const tookOf = (trip, late_s, level) => { // TripTimes.took_s: of the logged trips with about the same wait
  const count = trip.late_s.length;
  const near = Math.min(facts.near_trips, count);
  let first = 0;
  while (first < count && trip.late_s[first] < late_s) first += 1;
  first = Math.min(Math.max(first - Math.floor(near / 2), 0), count - near);
  const some = trip.took_s.slice(first, first + near).sort((a, b) => a - b);
  return some[Math.min(Math.floor(level * near), near - 1)];
};
const opensAt = (row, events, works_s) => { // when it may go on; infinite: not known yet
  let latest = Math.max(works_s, row.leg.notBefore_s);
  for (let n = 0; n < row.lags.length; n += 1) { // of an event that comes in no agenda nobody waits for it: -Infinity
    if (row.lags[n] !== -Infinity) latest = Math.max(latest, events[row.leg.due[n].event] + row.lags[n]);
  }
  return latest;
};

const unhindered = (rows, events, pace) => { // the operator, or a source of parts: he goes on as far as is known
  let at = 0;
  let ended = false;
  const arrive = (departs_s) => {
    const row = rows[at];
    row.arrives_s = departs_s + row.walk_s;
    row.works_s = row.arrives_s + row.own_s;
    set(events, row.leg.arrives, row.arrives_s);
  };
  arrive(0);
  return () => {
    let moved = false;
    while (!ended) {
      const row = rows[at];
      let open_s = opensAt(row, events, row.works_s);
      if (open_s === Infinity) break;
      if (row.leg.trip) open_s = afterTrip(row, events, open_s, pace);
      if (row.leg.ifWaits && opensAt(row, events, rows[at - 1].passes_s) <= rows[at - 1].passes_s) { // he need not wait: straight on
        open_s = row.arrives_s = row.works_s = rows[at - 1].passes_s;
        rows[at + 1].walk = rows[at + 1].straight;
        rows[at + 1].walk_s = tookWalk_s(rows[at + 1].walk, pace);
      }
      row.passes_s = open_s;
      set(events, row.leg.passes, open_s);
      moved = true;
      if (at === rows.length - 1) ended = true;
      else { at += 1; arrive(open_s); }
    }
    return moved;
  };
};

const operatorAt = (rows, pace) => { // OperatorPositions.at: between which samples he is, and how far
  const starts = Math.max(rows.findIndex((row) => row.leg.start !== null), 0);
  let at = 0;
  return (t_s, found) => {
    while (at < rows.length - 1 && rows[at].passes_s <= t_s) at += 1;
    const row = rows[at];
    const still = at < starts;
    const walks = t_s < row.arrives_s;
    let segment = still ? rows[starts].walk : (walks ? row.walk : row.stay);
    const departs_s = at > 0 ? rows[at - 1].passes_s : 0;
    let since_s = still ? 0 : (walks ? (t_s - departs_s) * pace / facts.segments[segment][2] : t_s - row.arrives_s);
    if (row.leg.trip && !still && !walks && t_s >= row.works_s && (row.passes_s < Infinity ? row.goes : row.waiting)) {
      since_s = (t_s - row.works_s) * pace; // on a trip, or back from one
      if (row.trip >= 0) segment = row.trip;
    }
    if (row.after >= 0 && !still && t_s > row.passes_s) { // he has done his last task
      segment = row.after;
      since_s = (t_s - row.passes_s) * pace / facts.segments[segment][2];
    }
    const [first, count] = facts.segments[segment];
    const place = Math.min(since_s / STEP_S, count - 1);
    const whole = Math.floor(place);
    found.from = first + whole;
    found.to = found.from + 1;
    found.weight = place - whole;
  };
};

const walkBoth = (robot, operator, sources, events, asked, until_s) => { // one cycle to its end
  const others = [operator, ...sources].map((rows) => unhindered(rows, events, asked.pace));
  const waits = {
    opensAt: (row, since_s) => opensAt(row, events, since_s),
    arrived: (row, at_s) => set(events, row.leg.arrives, at_s),
    departed: (row, at_s) => set(events, row.leg.passes, at_s),
    settle: () => { while (others.map((goOn) => goOn()).some(Boolean) && others.length > 1); },
  };
  const dynamics = { ...facts.dynamics, ...(asked.ramp === null ? {} : { ramp_up_per_s: asked.ramp }) };
  return walkRobot(robot, operatorAt(operator, asked.pace), { dynamics, waits, until_s });
};
