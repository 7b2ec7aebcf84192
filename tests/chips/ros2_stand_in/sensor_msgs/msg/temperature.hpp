#ifndef STAND_IN_TEMPERATURE_HPP
#define STAND_IN_TEMPERATURE_HPP
#include <cstdint>
#include <istream>
#include <ostream>
#include <string>
namespace sensor_msgs::msg {
struct Temperature {
    double temperature = 0;
};
inline std::istream &operator>>(std::istream &in, Temperature &m) {
    std::string word;  // a number or nan, which streams do not read
    in >> word;
    m.temperature = static_cast<double>(std::stod(word));
    return in;
}
inline std::ostream &operator<<(std::ostream &out, const Temperature &m) { return out << m.temperature; }
}  // namespace sensor_msgs::msg
#endif
