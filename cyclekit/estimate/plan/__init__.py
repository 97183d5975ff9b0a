"""Which order of the same work takes least time: the search behind `cyclekit plan`.

jobs    what is to be visited, and what must come before what
search  all orders where they are few; else greedy, Monte Carlo and a local search
exact   orders as `estimate` gives them
answer  the order found, what it saves against the logged ones, and how much of that is luck of the logs
"""

from cyclekit.estimate.plan.answer import Plan, plan
from cyclekit.estimate.plan.jobs import Jobs, load_jobs
from cyclekit.estimate.plan.search import some

__all__ = ["Jobs", "Plan", "load_jobs", "plan", "some"]
