"""The speed scaling: logged, or inferred from motion (`infer`); its levels (`levels`) and its response in time.

In: runs and executions. Out: scaling with its uncertainty per row, levels, latency, ramps, hysteresis. Used by `derive`
and `learning`.
"""
