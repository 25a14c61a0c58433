// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/laboratory.hpp"

namespace axon::simulation {

using namespace std::chrono_literals;

const char* const kServicesProfile = R"(<?xml version="1.0" encoding="UTF-8"?>
<ServiceProfile count="5">
  <Service name="Driving" type="SMPL" blocking="true" pausable="true" parameter_count="1">
    <Parameters>
      <Param name="Speed" type="CONFIG" data_type="INT" value="200" savable="true"/>
    </Parameters>
  </Service>
  <Service name="Turning" type="SMPL" blocking="true" pausable="false"/>
  <Service name="Light" type="SMPL" blocking="false"/>
  <Service name="Lift" type="SMPL" blocking="true" pausable="true" on_client_loss="hold"/>
  <Service name="Dock" type="SMPL" blocking="true" on_client_loss="finish" max_duration="2"/>
</ServiceProfile>
)";

Duration aloneFor(std::string_view service) {
    return service == "Lift" ? 1s : service == "Dock" ? 2s : Duration{};
}

std::string basicProfile(const std::string& name) {
    return R"(<?xml version="1.0" encoding="UTF-8"?>
<BasicProfile name=")" +
           name + R"(" category="ROBOT" type="MOBILE" descr="simulated" xpos="0" ypos="0" zpos="0"/>
)";
}

}  // namespace axon::simulation
