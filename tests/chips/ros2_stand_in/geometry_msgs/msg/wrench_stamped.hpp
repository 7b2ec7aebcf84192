#ifndef STAND_IN_WRENCH_STAMPED_HPP
#define STAND_IN_WRENCH_STAMPED_HPP
#include <istream>
#include <ostream>
#include <string>
namespace geometry_msgs::msg {
struct Vector3 {
    double x = 0.0, y = 0.0, z = 0.0;
};
struct WrenchStamped {
    struct {
        double stamp = 0.0;
        std::string frame_id;
    } header;
    struct {
        Vector3 force, torque;
    } wrench;
};
inline std::istream &operator>>(std::istream &in, WrenchStamped &m) {
    auto &w = m.wrench;
    return in >> w.force.x >> w.force.y >> w.force.z >> w.torque.x >> w.torque.y >> w.torque.z;
}
inline std::ostream &operator<<(std::ostream &out, const WrenchStamped &m) {
    const auto &w = m.wrench;
    return out << w.force.x << ' ' << w.force.y << ' ' << w.force.z << ' ' << w.torque.x << ' '
               << w.torque.y << ' ' << w.torque.z;
}
}  // namespace geometry_msgs::msg
#endif
