"""The one loop, Tangent -> step -> event -> cross -> orthonormalise -> collect, with its preparation and its driver."""
