"""The speed scaling: logged, or inferred from motion (`infer`); its levels (`levels`); its response over time.

In: runs and executions. Out: scaling with its uncertainty per row, levels, latency, ramps, hysteresis. Used by `derive`
and `learning`.
"""
