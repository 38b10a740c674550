"""What Hypothesis draws for a scene of one sphere, ordinary and extreme."""

import hypothesis.strategies as st
import numpy as np

import diffshade as ds

LOBES = (ds.Phong(), ds.Blinn())
lobes = st.sampled_from(LOBES)
colours = st.tuples(*[st.floats(0.01, 2)] * 3)
factors = st.floats(0, 10)
lengths = st.floats(0.1, 10)
coordinates = st.floats(-5, 5)
points = st.tuples(coordinates, coordinates, coordinates)
directions = points.filter(lambda d: np.linalg.norm(d) > 0.1)
sphere_points = directions.map(lambda d: np.divide(d, np.linalg.norm(d)))
positions = st.builds(np.multiply, sphere_points, st.floats(1.5, 6))  # outside the sphere, where lights do something
eyes = st.builds(np.multiply, sphere_points, st.just(4)).filter(lambda e: np.hypot(e[0], e[2]) > 1)
materials = st.builds(ds.Material, colours, colours, colours, st.floats(0, 200), lobes)
attenuations = st.builds(ds.RadialAttenuation, st.floats(0.1, 2), st.floats(0, 1), st.floats(0, 1))
point_lights = st.builds(ds.PointLight, positions, colours, attenuations)
directional_lights = st.builds(ds.DirectionalLight, directions, colours)
spot_lights = st.builds(
    ds.SpotLight, positions, directions, colours, st.floats(20, 90), st.floats(0, 30), attenuations, st.floats(0, 20)
)
lights = st.tuples(point_lights, directional_lights, spot_lights)

# Lights on the surface, in its tangent plane, behind it, far away; highlights as sharp as they come.
extreme_positions = st.builds(np.multiply, sphere_points, st.sampled_from([0, 0.5, 1 - 1e-9, 1, 1 + 1e-9, 3, 1e6]))
extreme_exponents = st.sampled_from([0, 1e-6, 0.5, 1, 1e3, 1e4])
extreme_attenuations = st.sampled_from(
    [ds.RadialAttenuation(*a) for a in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1e-3, 0, 1e3), (1e6, 0, 1e-6))]
)
extreme_lights = st.tuples(
    st.builds(ds.PointLight, extreme_positions, st.sampled_from([0, 1, 1e6]), extreme_attenuations),
    st.builds(ds.DirectionalLight, sphere_points, st.sampled_from([0, 1, 1e6])),
    st.builds(
        ds.SpotLight,
        extreme_positions,
        sphere_points,
        st.just(1),
        st.sampled_from([0.01, 45, 90]),
        extreme_exponents,
        extreme_attenuations,
        st.sampled_from([0, 0.01]),
    ),
)
extreme_materials = st.builds(ds.Material, colours, colours, st.sampled_from([0, 1, 1e3]), extreme_exponents, lobes)
extreme_eyes = st.sampled_from([(0, 0, 4), (0, 0, 1), (0, 0, 1.0000001), (0, 0.5, 0), (0, 0, 1e5), (1, 0, 1)])
