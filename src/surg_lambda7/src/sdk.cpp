#include "sdk.hpp"

#include <dlfcn.h>
#include <glob.h>

#include <cstdlib>

namespace surg_teleop {
namespace {

// The soname, and the plain name of a development link.
constexpr const char* kNames[] = {"libdrd.so.3", "libdrd.so"};

// Versions of the library in a folder, newest last.
std::vector<std::string> versions_in(const std::string& folder) {
  glob_t matches;
  std::vector<std::string> files;
  if (glob((folder + "/libdrd.so.3.*").c_str(), 0, nullptr, &matches) == 0) {
    files.assign(matches.gl_pathv, matches.gl_pathv + matches.gl_pathc);
  }
  globfree(&matches);
  return files;
}

template <typename Function>
bool find(void* library, const char* name, Function* function, std::string* lacks) {
  *function = reinterpret_cast<Function>(dlsym(library, name));
  if (*function == nullptr) *lacks = name;
  return *function != nullptr;
}

// All functions of a library; `lacks` names the first that it does not have.
std::optional<Sdk> bind(void* library, std::string* lacks) {
  Sdk sdk{};
  const bool complete =
      find(library, "drdOpen", &sdk.open, lacks) &&
      find(library, "drdOpenID", &sdk.open_id, lacks) &&
      find(library, "drdClose", &sdk.close, lacks) && find(library, "drdStop", &sdk.stop, lacks) &&
      find(library, "drdIsInitialized", &sdk.is_initialized, lacks) &&
      find(library, "drdAutoInit", &sdk.auto_init, lacks) &&
      find(library, "dhdHasWrist", &sdk.has_wrist, lacks) &&
      find(library, "dhdHasGripper", &sdk.has_gripper, lacks) &&
      find(library, "dhdIsLeftHanded", &sdk.is_left_handed, lacks) &&
      find(library, "dhdSetGravityCompensation", &sdk.set_gravity_compensation, lacks) &&
      find(library, "dhdSetMaxForce", &sdk.set_max_force, lacks) &&
      find(library, "dhdEnableForce", &sdk.enable_force, lacks) &&
      find(library, "dhdGetPositionAndOrientationFrame", &sdk.get_pose, lacks) &&
      find(library, "dhdGetGripperAngleRad", &sdk.get_gripper_angle, lacks) &&
      find(library, "dhdGetButtonMask", &sdk.get_buttons, lacks) &&
      find(library, "dhdSetForceAndTorqueAndGripperForce", &sdk.set_force, lacks) &&
      find(library, "dhdErrorGetLastStr", &sdk.last_error, lacks) &&
      find(library, "dhdGetSystemName", &sdk.system_name, lacks);
  if (!complete) return std::nullopt;
  return sdk;
}

}  // namespace

std::vector<std::string> places() {
  std::vector<std::string> places;
  if (const char* file = std::getenv("FORCEDIM_LIBRARY")) places.emplace_back(file);
  std::vector<std::string> folders;
  if (const char* root = std::getenv("FDSDK")) {
    folders.push_back(std::string(root) + "/lib/release/lin-x86_64-gcc");
  }
  if (const char* home = std::getenv("HOME")) folders.push_back(std::string(home) + "/.local/lib");
  folders.emplace_back("/usr/local/lib");
  for (const std::string& folder : folders) {
    for (const char* name : kNames) places.push_back(folder + "/" + name);
    const std::vector<std::string> versions = versions_in(folder);
    places.insert(places.end(), versions.rbegin(), versions.rend());
  }
  places.emplace_back(kNames[0]);  // LD_LIBRARY_PATH and the system's folders
  return places;
}

Loaded load(const std::vector<std::string>& places) {
  Loaded loaded;
  for (const std::string& place : places) {
    void* library = dlopen(place.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (library == nullptr) {
      loaded.tried.emplace_back(dlerror());
      continue;
    }
    std::string lacks;
    loaded.sdk = bind(library, &lacks);
    if (loaded.sdk) {
      loaded.path = place;
      return loaded;
    }
    loaded.tried.push_back(place + ": has no function " + lacks);
    dlclose(library);
  }
  return loaded;
}

}  // namespace surg_teleop
