"""Room-acoustic parameters of ISO 3382-1, -2, -3 and IEC 60268-16, from echograms in bands.

A parameter is a function of a `response.Response`, or of several, and a line in
`dataset.room_parameters.PARAMETERS`.
"""
