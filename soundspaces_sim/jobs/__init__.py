"""Jobs that build datasets: a plan, tiles that any process can make, and a finish.

plan      what is to be made: tiles and shards, from a config, points and a model; no files
record    the folder's `job.npz`: all that a worker needs beside the number of a tile
tile      one tile, again and again with the same result
finish    the manifest of a folder whose tiles are all there
engines/  who runs the tiles
build     all of it, for one scene
"""
