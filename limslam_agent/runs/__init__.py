"""One run of an agent in the simulator: policies, episode, results, film, and the scoring of other
actors.
"""
