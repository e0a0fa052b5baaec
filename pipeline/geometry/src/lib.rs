//! Rigid transforms, cameras, kinematics, meshes and the mesh rasteriser.
