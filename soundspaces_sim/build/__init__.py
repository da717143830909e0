"""Jobs that build datasets: a plan, tiles that any process can make, and a finish.

plan      tiles and shards of a job, from a config, points and a model; touches no files
prepare   points, graph and plan of a scene, and its folder
job_file  the folder's `job.npz`: the input of a worker, beside the number of a tile
schedule  the order of tiles, and their division among machines
tile      makes one tile; repeated runs give the same bytes
worker    entry point of every engine: makes a tile, given a folder and a number
finish    writes the manifest of a folder once all of its tiles exist
engines/  run the tiles: on this machine or on a cluster
build     the whole sequence, for one scene or many
estimate, forecast   remaining cost of a job; cost of one before it starts
status    progress of a job, from its folder
"""
