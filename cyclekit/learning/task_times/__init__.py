"""How long tasks of robot and operator take beside each other, and what each waits for: learned from task lists.

In: table TASKS of a dataset made of task lists, no positions. Out: a `TaskModelCard`, kept as `model.json`.

runs     the logged executions, tasks by agent
rates    how fast a task goes on beside each task of the other agent
starts   what a task waits for before it starts
learn    all of it, and the errors on orders that were held out
saved    write and read it
"""
