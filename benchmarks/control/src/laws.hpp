// The laws to be had; a library that was not found at build time has none.
#pragma once

#include <memory>
#include <vector>

#include "arm.hpp"

namespace bench {

using Laws = std::vector<std::unique_ptr<Law>>;

void add_own(Laws& laws, const Scene& scene);
void add_kdl(Laws& laws, const Scene& scene);
void add_eiquadprog(Laws& laws, const Scene& scene);
void add_proxqp(Laws& laws, const Scene& scene);

}  // namespace bench
