"""Search for the fastest order of the same work, behind `cyclekit plan`.

jobs         the places to visit, and precedence constraints
search       all orders if there are few; else greedy, Monte Carlo and a local search
both         orders of both agents, where one waits for the other
task_orders  orders of both agents' tasks, by a model of task times
answer       the order found, its saving over the logged ones, and the part of it that holds for other operators
"""

from cyclekit.estimate.plan.answer import OrderPlan, plan
from cyclekit.estimate.plan.jobs import Jobs, load_jobs
from cyclekit.estimate.plan.search import some

__all__ = ["Jobs", "OrderPlan", "load_jobs", "plan", "some"]
