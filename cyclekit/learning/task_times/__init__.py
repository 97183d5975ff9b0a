"""Task times and wait conditions of robot and operator, including mutual slowing, learned from task lists.

In: table TASKS of a dataset made of task lists, no positions. Out: a `TaskModelCard`, stored as `model.json`.

runs     the logged executions, tasks by agent
clocks   the executions in one clock, where one agent's is off
parts    the repetitions of a task, cut where simultaneous tasks start, are half over, or end
fit      mean, scatter and effects of one task
rates    the rate of a task during each task of the other agent
starts   the conditions of a task's start; those that it does not show alone by `alike`, `partly`, `process`,
         `unseen_parts`
prepared a plan with the learned times, rates and conditions of its tasks
roll     many cycles of one plan
learn    all of it, with errors on held-out orders
saved    storage
"""
