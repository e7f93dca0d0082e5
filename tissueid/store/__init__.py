"""Files that hold results: bundles, curves, output sets, and the schemas they are held to.

The one owner of HDF5.  Nothing here fits, samples or draws, and nothing here needs pandas, scipy,
lmfit, emcee or click, so that a renderer can load a bundle at the cost of numpy and h5py.
"""
