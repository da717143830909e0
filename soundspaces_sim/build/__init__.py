"""Jobs that build datasets: a plan, tiles that any process can make, and a finish.

plan      what is to be made: tiles and shards, from a config, points and a model; no files
prepare   the beginning: points, graph and plan of a scene, and its folder
record    the folder's `job.npz`: all that a worker needs beside the number of a tile
schedule  in which order tiles are made, and which of them are whose
tile      one tile, again and again with the same result
worker    what every engine calls: a tile, from a folder and a number
finish    the manifest of a folder whose tiles are all there
engines/  who runs the tiles
build     all of it, for one scene or many
estimate, forecast   what is left of a job that begins; what one would take, before it begins
status    how far one is, from its folder
"""
